"""A neural network in a local ONNX file: named by path and hash, run by onnxruntime.

Nothing is ever downloaded and nothing unpickled. A model is one file, so that one hash names all of
it; weights kept in a second file beside it are refused.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import PluginError
from ...system.memory import peak_memory_mb
from .model_file import read_model_file
from .onnx_content import check_content
from .onnx_session import (
    LONGEST_ANSWER,
    OnnxProvider,
    choose_provider,
    first_line,
    open_session,
    processors,
    running_provider,
)

if TYPE_CHECKING:
    import torch
    from torch import Tensor

_log = logging.getLogger("stereogs.priors")
_TYPES = {  # names of torch's types
    "tensor(float)": "float32",
    "tensor(float16)": "float16",
    "tensor(double)": "float64",
    "tensor(uint8)": "uint8",
    "tensor(int32)": "int32",
    "tensor(int64)": "int64",
    "tensor(bool)": "bool",
}


@dataclass(frozen=True)
class OnnxTensor:
    """What a model says of one of its inputs or outputs.

    Args:
        name: in the graph.
        shape: sizes; None where the graph leaves one open.
        dtype: the type inside the graph; `OnnxModel.run` converts.
    """

    name: str
    shape: tuple[int | None, ...]
    dtype: torch.dtype

    def __str__(self) -> str:
        sizes = ", ".join("?" if size is None else str(size) for size in self.shape)
        return f"{self.name} {str(self.dtype).removeprefix('torch.')}[{sizes}]"


class OnnxModel:
    """An ONNX model, loaded and ready; the same question gets the same bits on one provider.

    The first answer is told of in the log: seconds, threads and memory; later ones at the level DEBUG.

    Args:
        path: the `.onnx` file.
        sha256: 64 hexadecimal digits that the file must have, or None: any file is taken.
        provider: what runs it, or None: the first of `OnnxProvider` that is installed.
        threads: of the processor, or None: as many as this process may use.

    Attributes:
        path: the file.
        sha256: the file's own hash, 64 hexadecimal digits.
        provider: what runs it, one of `OnnxProvider`.
        threads: how many run it on the processor.
        inputs, outputs: in the graph's order.

    Raises:
        PluginError: a missing file, another hash, no ONNX model, weights in a second file, a type
            that cannot be converted, or a provider that is not installed or cannot start.
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
        self.threads = threads or processors()
        self._session = open_session(file.content, self.path, chosen, self.threads)
        self.provider = running_provider(self._session, provider)
        self.inputs = _described(self._session.get_inputs(), self.path)
        self.outputs = _described(self._session.get_outputs(), self.path)
        self._told = False

    @property
    def fingerprint(self) -> str:
        """What answers depend on: the file's hash, what runs it and in which version."""
        import onnxruntime

        return f"{self.sha256} {self.provider} onnxruntime {onnxruntime.__version__}"

    def input(self, name: str | None = None) -> OnnxTensor:
        """The input of this name, or for None the only one.

        Raises:
            PluginError: there is no such input, or None does not say which.
        """
        return self._find("input", self.inputs, name)

    def output(self, name: str | None = None) -> OnnxTensor:
        """The output of this name, or for None the only one.

        Raises:
            PluginError: see `input`.
        """
        return self._find("output", self.outputs, name)

    def run(self, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """All outputs, float32, on the CPU; they may hold values that are not finite.

        Args:
            inputs: float32 by name, one for each of the graph's inputs; for a graph that takes whole
                numbers they are rounded, for uint8 also clamped to [0, 255].

        Raises:
            PluginError: a name or shape that is not the graph's, a failure inside the model, or no
                answer within an hour.
        """
        import numpy as np
        import torch

        unknown = [name for name in inputs if name not in {spec.name for spec in self.inputs}]
        missing = [spec.name for spec in self.inputs if spec.name not in inputs]
        if unknown or missing:
            raise self._mismatch(
                "the model's inputs have other names: "
                f"given without being asked {unknown}, asked for and not given {missing}"
            )
        feed = {spec.name: self._converted(spec, inputs[spec.name]) for spec in self.inputs}
        begin = time.perf_counter()
        answers = self._answers(feed)
        self._tell(time.perf_counter() - begin, feed)
        return {
            spec.name: torch.from_numpy(np.array(answer, dtype=np.float32))
            for spec, answer in zip(self.outputs, answers, strict=True)
        }

    def _tell(self, seconds: float, feed: Mapping[str, Any]) -> None:
        """What an answer cost; onnxruntime keeps its memory, so the first one shows nearly all of it."""
        level = logging.DEBUG if self._told else logging.INFO
        self._told = True
        if not _log.isEnabledFor(level):
            return
        sizes = ", ".join(f"{name} {list(value.shape)}" for name, value in feed.items())
        memory = peak_memory_mb()
        _log.log(
            level,
            "%s: %.2f s on %s, %d threads, for %s%s",
            self.path.name,
            seconds,
            self.provider,
            self.threads,
            sizes,
            "" if memory is None else f"; memory of this process at most {memory:.0f} MB so far",
        )

    def _answers(self, feed: Mapping[str, Any]) -> Any:
        """What the session answers, unless it takes too long: a graph may loop without end."""
        import onnxruntime

        options = onnxruntime.RunOptions()
        watch = threading.Timer(LONGEST_ANSWER, setattr, (options, "terminate", True))
        watch.daemon = True
        watch.start()
        try:
            return self._session.run(None, feed, options)
        except Exception as error:  # onnxruntime's exceptions have no base of their own
            if options.terminate:
                what = f"the model gave no answer within {LONGEST_ANSWER:g} s"
                fix = "use smaller images; if that does not help, the graph loops without end"
            else:
                what = f"the model failed: {first_line(error)}"
                fix = "check that the graph fits the images' size; make them smaller if memory ran out"
            raise PluginError(what, where=str(self.path), fix=fix) from error
        finally:
            watch.cancel()
            watch.join()  # else it may still be there when the host counts the threads

    def _converted(self, spec: OnnxTensor, value: Tensor) -> Any:
        import torch

        shape = tuple(value.shape)
        fits = len(shape) == len(spec.shape) and all(
            wanted in (None, got) for wanted, got in zip(spec.shape, shape, strict=True)
        )
        if not fits:
            raise self._mismatch(f"the input {spec.name!r} cannot have the shape {list(shape)}")
        value = value.detach().to("cpu", torch.float32)
        if not spec.dtype.is_floating_point:
            value = value.round()
        if spec.dtype == torch.uint8:
            value = value.clamp(0, 255)
        return value.to(spec.dtype).contiguous().numpy()

    def _find(self, kind: str, specs: Sequence[OnnxTensor], name: str | None) -> OnnxTensor:
        if name is None and len(specs) == 1:
            return specs[0]
        for spec in specs:
            if spec.name == name:
                return spec
        what = f"no {kind} {name!r}" if name else f"{len(specs)} {kind}s; which one is not said"
        raise self._mismatch(f"the model has {what}")

    def _mismatch(self, what: str) -> PluginError:
        has = "; ".join(
            f"{kind}: {', '.join(str(spec) for spec in specs) or 'none'}"
            for kind, specs in (("inputs", self.inputs), ("outputs", self.outputs))
        )
        return PluginError(
            what,
            where=str(self.path),
            fix=f"choose the settings that fit this graph, which has {has}",
        )


def _described(specs: Sequence[Any], path: Path) -> tuple[OnnxTensor, ...]:
    import torch

    described = []
    for spec in specs:
        if spec.type not in _TYPES:
            raise PluginError(
                f"{spec.name!r} of the model has the type {spec.type}, which is not supported",
                where=str(path),
                fix=f"export it with one of {', '.join(_TYPES)}",
            )
        sizes = (s if isinstance(s, int) and s > 0 else None for s in spec.shape)
        described.append(OnnxTensor(spec.name, tuple(sizes), getattr(torch, _TYPES[spec.type])))
    return tuple(described)
