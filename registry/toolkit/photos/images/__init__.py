"""Files of photographs: which there are, how they are decoded and resized."""
