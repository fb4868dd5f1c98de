"""What kind of scene photographs show, told from cameras and images alone."""
