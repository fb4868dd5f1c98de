"""Where a result comes from: versions and commit, and digests of what was read."""
