"""How onnxruntime is started on a model file: the provider, threads, determinism."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args

from ...errors import PluginError
from ...system.memory import machine_memory

OnnxProvider = Literal["cuda", "rocm", "migraphx", "openvino", "coreml", "directml", "cpu"]
"""What runs a model: NVIDIA; AMD (two libraries); Intel; Apple; Windows; any processor."""

LONGEST_ANSWER = 3600.0
"""Seconds, far beyond what any network takes for photographs of a usual size on a processor."""

MEMORY_SHARE = 0.5
"""Of the machine's memory, for all networks of a process together while they run on the processor."""

_PROVIDERS: dict[str, tuple[str, dict[str, str]]] = {
    # The choice among convolution algorithms by stopwatch, and the short TF32 numbers, would let two
    # runs differ from each other and from the processor's answer.
    "cuda": ("CUDAExecutionProvider", {"cudnn_conv_algo_search": "DEFAULT", "use_tf32": "0"}),
    "rocm": ("ROCMExecutionProvider", {}),
    "migraphx": ("MIGraphXExecutionProvider", {}),
    "openvino": ("OpenVINOExecutionProvider", {}),
    "coreml": ("CoreMLExecutionProvider", {}),
    "directml": ("DmlExecutionProvider", {}),
    "cpu": ("CPUExecutionProvider", {}),
}


def choose_provider(wanted: OnnxProvider | None) -> list[tuple[str, dict[str, str]]]:
    """onnxruntime's names and options: the wanted one, or all that are installed, best first.

    Raises:
        PluginError: the wanted one is not installed.
    """
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
    """An `onnxruntime.InferenceSession` on so many processor threads.

    Raises:
        PluginError: the bytes are no model that it can load.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    # Exceptions say the same; the log would print names out of the file, escape codes and all.
    options.log_severity_level = 4
    # Between two calls the threads sleep instead of spinning: OpenCL needs the processor then.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if _bound_memory():
        options.add_session_config_entry("session.use_env_allocators", "1")
    try:
        session = onnxruntime.InferenceSession(
            content, options, providers=providers, enable_fallback=len(providers) > 1
        )
    except Exception as error:  # onnxruntime's exceptions have no base of their own
        raise PluginError(
            f"the file is no ONNX model that onnxruntime can load: {first_line(error)}",
            where=str(path),
            fix="export the model to ONNX again, with an opset that onnxruntime "
            f"{onnxruntime.__version__} knows",
        ) from error
    session.disable_fallback()  # else a failure later on is answered by another provider, unasked
    return session


@cache
def _bound_memory() -> bool:
    """Let no graph take the whole machine, once a process; whether a bound could be set.

    An allocation beyond it fails inside onnxruntime, and the run with it, as any other failure.
    """
    import onnxruntime

    memory = machine_memory()
    if memory is None:
        return False
    kind = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
    place = onnxruntime.OrtMemoryInfo("Cpu", kind, 0, onnxruntime.OrtMemType.DEFAULT)
    # Only the first is chosen here; the rest leave onnxruntime its own values.
    bounds = {
        "max_mem": int(MEMORY_SHARE * memory),
        "arena_extend_strategy": -1,
        "initial_chunk_size_bytes": -1,
        "max_dead_bytes_per_chunk": -1,
    }
    onnxruntime.create_and_register_allocator(place, onnxruntime.OrtArenaCfg(bounds))
    return True


def running_provider(session: Any, wanted: OnnxProvider | None) -> OnnxProvider:
    """What the session really runs on: onnxruntime falls back to the processor in silence.

    Raises:
        PluginError: that is not what was wanted.
    """
    running = session.get_providers()[0]
    names: tuple[OnnxProvider, ...] = get_args(OnnxProvider)
    name = next(name for name in names if _PROVIDERS[name][0] == running)
    if wanted not in (None, name):
        raise PluginError(
            f"onnxruntime could not start {wanted!r} and would run the model on {name!r}",
            fix=f"install the libraries that {wanted!r} needs, or choose {name!r}",
        )
    return name


def processors() -> int:
    """How many processors this process may use; fewer than the machine's in a container."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def first_line(error: Exception) -> str:
    """What an exception of a library in C++ says, without the trace that may follow."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
