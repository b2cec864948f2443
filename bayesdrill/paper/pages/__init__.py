"""What people look at of the paper: its tables, figures and text."""
