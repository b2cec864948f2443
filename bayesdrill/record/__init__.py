"""What was measured: files of every format, and the experiment that they make."""
