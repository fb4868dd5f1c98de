def print_tables(result): 
    from rich.console import Console; from rich.table import Table
    c=Console(width=200)
    for n,s in result["scenes"].items():
        t=Table(*list(s["rows"][0].keys()))
        for r in s["rows"]: t.add_row(*(f"{v:.3g}" if isinstance(v,float) else str(v) for v in r.values()))
        c.print(t); c.print(s["sparse_adam"])
def write_docs(result): return []
