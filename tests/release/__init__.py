"""What is published: the distributions in an empty environment, and the tests on other Pythons."""
