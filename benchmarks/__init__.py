"""Benchmarks of quality, time and error.

Records of trainings are in `records`, complete tables in `tables`, lab notes in `notes.md`.
"""
