"""What the programs' shells share: clock, loop rate, a thread for input and output, systemd."""
