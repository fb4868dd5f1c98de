"""Registers the method `stereogs` and the sparse-view protocols with NerfBaselines.

Loaded through the entry point `nerfbaselines.specs`.
"""

from nerfbaselines import register

from registry.pipeline.protocols import load_protocol, protocol_names

register(
    {
        "id": "stereogs",
        "method_class": "stereogs.nerfbaselines.method:StereoGS",
        "metadata": {
            "name": "StereoGS plugins",
            "description": "Sparse-view 3D Gaussian splatting with every method a plugin; runs the "
            "pipeline of the setting `pipeline`.",
            "licenses": [{"name": "Apache-2.0"}],
        },
        "presets": {},
        "implementation_status": {},
    }
)
register(
    {
        "id": "stereogs",
        "evaluation_protocol_class": "stereogs.nerfbaselines.protocols:ProtocolScores",
    }
)
register({"id": "stereogs-views", "load_dataset_function": "stereogs.nerfbaselines.protocols:load"})
for protocol in map(load_protocol, protocol_names()):
    register(
        {
            "id": f"stereogs-{protocol.name}",
            "download_dataset_function": "stereogs.nerfbaselines.protocols:prepare",
            "evaluation_protocol": "stereogs",
            "metadata": {
                "id": f"stereogs-{protocol.name}",
                "name": protocol.title,
                "description": f"{protocol.split}; {protocol.scale}",
                "metrics": [metric["use"] for metric in protocol.metrics],
                "default_metric": "psnr",
                "scenes": [{"id": scene, "name": scene} for scene in protocol.scenes],
            },
        }
    )
