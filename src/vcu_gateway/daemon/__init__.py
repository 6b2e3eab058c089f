"""The process that drives: threads, ticks, systemd."""
