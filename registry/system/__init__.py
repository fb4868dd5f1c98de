"""What the operating system gives: files that are whole or absent, and how much memory something takes."""
