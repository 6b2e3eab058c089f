"""Pedals of this machine, input device or converters: a client that demands what they say."""
