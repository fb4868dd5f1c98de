"""Samplers: what an iteration learns from."""
