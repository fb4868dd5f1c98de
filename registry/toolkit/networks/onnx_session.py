"""Start onnxruntime: provider, threads, determinism, memory limit."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, Literal

from ...errors import PluginError
from ...system.memory import machine_memory

OnnxProvider = Literal["cuda", "rocm", "migraphx", "openvino", "coreml", "directml", "cpu"]
"""Backends: NVIDIA; AMD (two libraries); Intel; Apple; Windows; any CPU."""

TIME_LIMIT = 3600.0
"""Seconds; networks need far less for photographs of a usual size on a CPU."""

MEMORY_SHARE = 0.5
"""Share of the machine's memory for all networks of a process on the CPU together."""

_PROVIDERS: dict[OnnxProvider, tuple[str, dict[str, str]]] = {
    # With algorithms chosen by timing, two runs differ; with TF32, results differ from the CPU's.
    "cuda": ("CUDAExecutionProvider", {"cudnn_conv_algo_search": "DEFAULT", "use_tf32": "0"}),
    "rocm": ("ROCMExecutionProvider", {}),
    "migraphx": ("MIGraphXExecutionProvider", {}),
    "openvino": ("OpenVINOExecutionProvider", {}),
    "coreml": ("CoreMLExecutionProvider", {}),
    "directml": ("DmlExecutionProvider", {}),
    "cpu": ("CPUExecutionProvider", {}),
}


def choose_provider(wanted: OnnxProvider | None) -> list[tuple[str, dict[str, str]]]:
    """Return names and options for onnxruntime: of the wanted provider, or of all installed, best first."""
    import onnxruntime

    installed = onnxruntime.get_available_providers()
    usable = {name: entry for name, entry in _PROVIDERS.items() if entry[0] in installed}
    if wanted is None:
        return list(usable.values())
    if wanted not in usable:
        raise PluginError(
            f"onnxruntime cannot run models on {wanted!r} here",
            fix=f"choose one of {', '.join(usable)}, or install the onnxruntime package for it",
        )
    return [_PROVIDERS[wanted]]


def open_session(
    content: bytes, path: Path, providers: list[tuple[str, dict[str, str]]], threads: int
) -> Any:
    """Open an `onnxruntime.InferenceSession` with this many CPU threads."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    # Exceptions hold the same messages; the log would print escape codes from names in the file.
    options.log_severity_level = 4
    # Let threads sleep between two calls instead of spinning: OpenCL needs the CPU.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if _bound_memory():
        options.add_session_config_entry("session.use_env_allocators", "1")
    try:
        session = onnxruntime.InferenceSession(
            content, options, providers=providers, enable_fallback=len(providers) > 1
        )
    except Exception as error:  # onnxruntime's exceptions have no common base class
        raise PluginError(
            f"onnxruntime cannot load the ONNX model: {first_line(error)}",
            where=str(path),
            fix="export the model to ONNX again, with an opset that onnxruntime "
            f"{onnxruntime.__version__} supports",
        ) from error
    session.disable_fallback()  # a later failure must not switch the provider silently
    return session


@cache
def _bound_memory() -> bool:
    """Limit the CPU memory of all graphs, once per process; return whether a limit could be set.

    A larger allocation fails inside onnxruntime, and the call with it.
    """
    import onnxruntime

    memory = machine_memory()
    if memory is None:
        return False
    kind = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
    place = onnxruntime.OrtMemoryInfo("Cpu", kind, 0, onnxruntime.OrtMemType.DEFAULT)
    limit = onnxruntime.OrtArenaCfg({"max_mem": int(MEMORY_SHARE * memory)})
    onnxruntime.create_and_register_allocator(place, limit)
    return True


def running_provider(session: Any, wanted: OnnxProvider | None) -> OnnxProvider:
    """Return the provider in use, or refuse another than the wanted one: onnxruntime falls back silently."""
    running = session.get_providers()[0]
    name = next(name for name, (provider, _) in _PROVIDERS.items() if provider == running)
    if wanted not in (None, name):
        raise PluginError(
            f"onnxruntime could not start {wanted!r} and would run the model on {name!r}",
            fix=f"install the libraries that {wanted!r} needs, or choose {name!r}",
        )
    return name


def first_line(error: Exception) -> str:
    """Return the message of an exception from a C++ library, without the trace that may follow."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
