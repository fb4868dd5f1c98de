"""Run a neural network from a local ONNX file with onnxruntime.

Models are never downloaded or unpickled. A model is one file, so that one hash identifies it; weights in a
second file are refused.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field

from ...contract.component import Settings
from ...errors import PluginError
from ...system.cores import usable_cores
from ...system.memory import peak_memory_mb
from .model_file import Sha256, check_content, read_model_file
from .onnx_session import (
    TIME_LIMIT,
    OnnxProvider,
    choose_provider,
    first_line,
    open_session,
    running_provider,
)

if TYPE_CHECKING:
    import torch
    from torch import Tensor

_log = logging.getLogger("stereogs.priors")
_TYPES = ("float", "float16", "double", "uint8", "int32", "int64", "bool")
"""Element types by ONNX's names, which are names of torch too."""


_LIMIT: ContextVar[float] = ContextVar("limit", default=TIME_LIMIT)


@contextmanager
def answers_within(seconds: float) -> Iterator[None]:
    """Within the block, stop a graph that takes longer to answer, instead of after `TIME_LIMIT`."""
    token = _LIMIT.set(seconds)
    try:
        yield
    finally:
        _LIMIT.reset(token)


@dataclass(frozen=True)
class OnnxTensor:
    """An input or output of a graph; None in `shape` is a dynamic size, `OnnxModel.run` converts types."""

    name: str
    shape: tuple[int | None, ...]
    dtype: torch.dtype

    def __str__(self) -> str:
        sizes = ", ".join("?" if size is None else str(size) for size in self.shape)
        return f"{self.name} {str(self.dtype).removeprefix('torch.')}[{sizes}]"


class OnnxModel:
    """A loaded ONNX model; on one provider, equal inputs give equal bits.

        model = OnnxModel("depth.onnx", sha256)
        depth = model.run({model.input().name: images})[model.output().name]

    The first run is logged with its time, threads and memory; later runs at level DEBUG.

    Args:
        path: Path of the `.onnx` file.
        sha256: Required SHA-256, 64 hexadecimal digits; None accepts any file.
        provider: Backend; None selects the first installed one of `OnnxProvider`.
        threads: Number of CPU threads; None uses all that this process may use.

    Attributes:
        path, sha256, provider, threads: As given, or as found and chosen.
        inputs, outputs: Tensors in the graph's order.

    Raises:
        PluginError: The file is missing, has another hash, is not a valid ONNX model, stores weights in
            a second file, or has an unsupported type; or the provider is not installed or fails to start.
    """

    def __init__(
        self,
        path: str | Path,
        sha256: str | None = None,
        provider: OnnxProvider | None = None,
        *,
        threads: int | None = None,
    ) -> None:
        self.path = Path(path).expanduser()
        file = read_model_file(self.path, sha256)
        check_content(file.content, self.path)
        self.sha256 = file.sha256
        chosen = choose_provider(provider)
        self.threads = threads or usable_cores()
        self._session = open_session(file.content, self.path, chosen, self.threads)
        self.provider = running_provider(self._session, provider)
        self.inputs = _described(self._session.get_inputs(), self.path)
        self.outputs = _described(self._session.get_outputs(), self.path)
        if not (self.inputs and self.outputs):
            raise self._mismatch("the model has no input or no output")
        self._logged = False

    @property
    def fingerprint(self) -> str:
        """Everything that results depend on besides the inputs: hash, provider, version of onnxruntime."""
        import onnxruntime

        return f"{self.sha256} {self.provider} onnxruntime {onnxruntime.__version__}"

    def input(self, name: str | None = None) -> OnnxTensor:
        """Return the input of this name; None returns the only input.

        Raises:
            PluginError: The input does not exist, or the name is None and there are several.
        """
        return self._find("input", self.inputs, name)

    def output(self, name: str | None = None) -> OnnxTensor:
        """Return the output of this name; None returns the only output. Raises as `input`."""
        return self._find("output", self.outputs, name)

    def run(self, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return all outputs by name, float32 on the CPU; values may be non-finite.

        Args:
            inputs: float32 tensors by name, one for each input of the graph. They are rounded for
                integer inputs, and also clamped to [0, 255] for uint8.

        Raises:
            PluginError: A name or shape does not match the graph, the model fails, or it takes more
                than an hour, or than `answers_within` allows.
        """
        import numpy as np
        import torch

        unknown = [name for name in inputs if name not in {spec.name for spec in self.inputs}]
        missing = [spec.name for spec in self.inputs if spec.name not in inputs]
        if unknown or missing:
            raise self._mismatch(
                f"the names of the inputs do not match the model: unknown {unknown}, missing {missing}"
            )
        feed = {spec.name: self._converted(spec, inputs[spec.name]) for spec in self.inputs}
        begin = time.perf_counter()
        answers = self._answers(feed)
        self._log_run(time.perf_counter() - begin, feed)
        return {
            spec.name: torch.from_numpy(np.array(answer, dtype=np.float32))
            for spec, answer in zip(self.outputs, answers, strict=True)
        }

    def _log_run(self, seconds: float, feed: Mapping[str, Any]) -> None:
        """Log time and memory; onnxruntime keeps its memory, so the first run shows nearly all of it."""
        level = logging.DEBUG if self._logged else logging.INFO
        self._logged = True
        if not _log.isEnabledFor(level):
            return
        cost = f"{seconds:.2f} s on {self.provider}, {self.threads} threads"
        sizes = ", ".join(f"{name} {list(value.shape)}" for name, value in feed.items())
        memory = peak_memory_mb()
        if memory is not None:
            sizes += f"; memory of this process at most {memory:.0f} MB so far"
        _log.log(level, "%s: %s, for %s", self.path.name, cost, sizes)

    def _answers(self, feed: Mapping[str, Any]) -> Any:
        """Run the session with a time limit: a graph may contain an endless loop."""
        import onnxruntime

        options, limit = onnxruntime.RunOptions(), _LIMIT.get()
        timer = threading.Timer(limit, setattr, (options, "terminate", True))
        timer.daemon = True
        timer.start()
        try:
            return self._session.run(None, feed, options)
        except Exception as error:  # onnxruntime's exceptions have no common base class
            if options.terminate:
                what = f"the model did not finish within {limit:g} s"
                fix = "use smaller images; if that does not help, the graph has an endless loop"
            else:
                what = f"the model failed: {first_line(error)}"
                fix = "check that the graph supports the images' size; use smaller ones if memory ran out"
            raise PluginError(what, where=str(self.path), fix=fix) from error
        finally:
            timer.cancel()
            timer.join()  # the host checks for threads that are left over

    def _converted(self, spec: OnnxTensor, value: Tensor) -> Any:
        import torch

        shape = tuple(value.shape)
        fits = len(shape) == len(spec.shape) and all(
            wanted in (None, got) for wanted, got in zip(spec.shape, shape, strict=True)
        )
        if not fits:
            raise self._mismatch(f"the shape {list(shape)} does not match the input {spec.name!r}")
        value = value.detach().to("cpu", torch.float32)
        if not spec.dtype.is_floating_point:
            value = value.round()
        if spec.dtype == torch.uint8:
            value = value.clamp(0, 255)
        return value.to(spec.dtype).contiguous().numpy()

    def _find(self, kind: str, specs: Sequence[OnnxTensor], name: str | None) -> OnnxTensor:
        found = [spec for spec in specs if name in (None, spec.name)]
        if len(found) == 1:
            return found[0]
        several = f"{len(specs)} {kind}s; its name must be specified"
        raise self._mismatch(f"the model has {f'no {kind} {name!r}' if name else several}")

    def _mismatch(self, what: str) -> PluginError:
        has = "; ".join(
            f"{kind}: {', '.join(str(spec) for spec in specs) or 'none'}"
            for kind, specs in (("inputs", self.inputs), ("outputs", self.outputs))
        )
        fix = f"choose settings that match this graph, which has {has}"
        return PluginError(what, where=str(self.path), fix=fix)


def _described(specs: Sequence[Any], path: Path) -> tuple[OnnxTensor, ...]:
    import torch

    described = []
    for spec in specs:
        kind = spec.type.removeprefix("tensor(").removesuffix(")")
        if kind not in _TYPES:
            raise PluginError(
                f"{spec.name!r} of the model has the type {spec.type}, which is not supported",
                where=str(path),
                fix=f"export it with one of {', '.join(f'tensor({name})' for name in _TYPES)}",
            )
        sizes = (s if isinstance(s, int) and s > 0 else None for s in spec.shape)
        described.append(OnnxTensor(spec.name, tuple(sizes), getattr(torch, kind)))
    return tuple(described)


class OnnxModelSettings(Settings):
    """Settings of components that run an ONNX file."""

    model: Path
    """Path of the local ONNX file, which must contain its weights."""
    sha256: Sha256 | None = None
    """Required SHA-256 of the file; null accepts any file."""
    provider: OnnxProvider | None = None
    """Backend that runs the model; null selects the first installed one of this list."""
    threads: int | None = Field(None, ge=1)
    """Number of CPU threads that run the model; null uses all that this process may use."""

    @classmethod
    def naming(cls, model: OnnxModel) -> dict[str, str]:
        """Return the settings that select this model, for a pipeline."""
        return {"model": str(model.path), "sha256": model.sha256}

    def open(self, published: str = "") -> OnnxModel:
        """Load the model.

        Args:
            published: which network a missing file should contain, and where its weights are published.
        """
        try:
            return self.open_another(self.model, self.sha256)
        except PluginError as error:
            if published and not self.model.expanduser().exists():
                error.fix += f"\nthis prior expects {published}, exported to ONNX"
            raise

    def open_another(self, path: Path, sha256: str | None) -> OnnxModel:
        """Load a second model with the same provider and threads."""
        return OnnxModel(path, sha256, self.provider, threads=self.threads)
