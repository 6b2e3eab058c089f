"""Gateway and simulated vehicle in a process of their own: `program` is it, `child` its handle."""
