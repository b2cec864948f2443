"""What to believe: identifiability, verdict, physics, what follows, calibration."""
