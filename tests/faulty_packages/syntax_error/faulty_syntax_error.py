"""It is no Python."""

def loss(self, step:
