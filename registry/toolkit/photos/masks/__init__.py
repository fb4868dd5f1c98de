"""Find the masks of photographs, and read them."""
