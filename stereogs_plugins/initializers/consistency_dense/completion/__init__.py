"""Completion beyond the paper: points where no two views agree, and merging of those where they do."""
