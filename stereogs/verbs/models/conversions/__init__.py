"""Conversions of published weights to the files that priors and metrics read, a module per network.

Each module has `convert(content)`: from the content of the published file to the contents of the files that
`networks.NETWORKS` lists for it, in that order. Equal contents give equal bytes.
"""
