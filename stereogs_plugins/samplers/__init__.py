"""Samplers: choose and change the view that an iteration trains on."""
