"""What the commands do, one after the other: identify, posterior, report, calibrate."""
