"""Loss terms beside the photometric one."""
