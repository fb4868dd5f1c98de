"""Observers: how a run goes, told to the tools that people log with."""
