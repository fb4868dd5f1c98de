"""What a scene or a machine is like, before anything is trained."""
