"""Services that all programs share: the clock, the loop rate, the console, a thread for slow writes, and systemd."""
