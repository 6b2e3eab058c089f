"""Metrics, dashboard, alerts: what a person sees of a gateway from afar."""
