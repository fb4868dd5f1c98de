"""Tells NerfBaselines of the method `stereogs`, through the entry point `nerfbaselines.specs`."""

from nerfbaselines import register

register(
    {
        "id": "stereogs",
        "method_class": "stereogs.nerfbaselines_method:StereoGS",
        "metadata": {
            "name": "StereoGS plugins",
            "description": "Sparse-view 3D Gaussian splatting with every method a plugin; runs the "
            "pipeline that the setting `pipeline` names.",
            "licenses": [{"name": "Apache-2.0"}],
        },
        "presets": {},
        "implementation_status": {},
    }
)
