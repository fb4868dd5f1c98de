"""Packages with one fault each, from one table, and their installation as pip would do it."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Sequence
from importlib.metadata import EntryPoint, distributions
from pathlib import Path

import pytest

from tests.host import GROUP

PLUGIN = """\
import mmap, os, sys, threading, time
import torch
import registry
from registry.priors import MultiViewDepthPrior


class Faulty({base}[registry.Settings]):
{body}

@registry.hookimpl
def stereogs_register_{section}(register):
    register("{name}", Faulty)
"""


def plugin(
    name: str, body: str, *, section: str = "regularizers", base: str = "registry.Regularizer"
) -> str:
    """The source of a component with these methods."""
    indented = textwrap.indent(textwrap.dedent(body), "    ")
    return PLUGIN.format(name=name, body=indented, section=section, base=base)


def loss(fault: str) -> str:
    """The method of a regularizer that has a fault and then, if it comes that far, returns a loss."""
    statements = textwrap.indent(fault, "    ")
    return f"def loss(self, step):\n{statements}\n    return step.rendering.alpha.mean()\n"


IN_A_LOSS = {
    "changes_folder": "os.chdir('..')",
    "constant_loss": "return step.model.read('means').abs().mean()  # outside autograd",
    "draws_globally": "return step.rendering.alpha.mean() * torch.rand(())",
    "error_at_iteration": "if step.iteration == 5: raise KeyError('a view that is not there')",
    "exit_in_loss": "sys.exit(0)",
    "float_loss": "return float(step.rendering.alpha.mean().detach())",
    "hangs": "if step.iteration == 5: time.sleep(3600)",
    "leaves_thread": (
        "threading.Thread(target=time.sleep, args=(1,), name='leftover', daemon=True).start()"
    ),
    "logs_as_host": "step.log('loss', 0.0)",
    "nan_gradient": "return (step.rendering.alpha * 0).sqrt().sum()",
    "nan_loss": "return step.rendering.alpha.mean() * float('nan')",
    "seeds_globally": "torch.manual_seed(0)",
    "writes_camera": "step.scene.train[1].camera.world_to_camera[0, 3] += 0.1",
    "writes_image": "step.view.image.copy_(step.rendering.rgb.detach())",
    "writes_model": "step.model._model.write('means', 0.5 * step.model.read('means'))",
    "writes_past_torch": "step.view.image.numpy()[:] = step.rendering.rgb.detach().numpy()",
    "writes_points": "step.scene.points.positions.mul_(2)",
    "writes_step": "step.learning_rates['means'] = 0.0",
    "wrong_shape": "return step.rendering.alpha",
}
AGES = """\
ages = torch.zeros(0)

def loss(self, step):
    self.ages = (self.ages if len(self.ages) else torch.zeros(step.model.count)) + 1
    return step.rendering.alpha.mean()

def state(self):
    return {"ages": self.ages}

def restore(self, state):
    self.ages = state["ages"].clone()
"""
"""Counts the iterations of each Gaussian, and does not follow a change of topology."""

METHODS = {
    # New pages: an allocator may reuse freed ones.
    "grows_memory": "kept = []\n\n"
    + loss(
        "self.kept.append(mmap.mmap(-1, 32_000_000))\nself.kept[-1].write(bytes([1]) * 32_000_000)"
    ),
    "missing_carry": AGES,
    "wrong_carry": AGES
    + "def carry(self, source, fresh):\n    self.ages = self.ages[source + 1]\n",
    "unsavable_state": loss("") + "def state(self):\n    return {'seen': ['view0']}\n",
    "wrong_signature": "def loss(self):\n    return 0.0\n",
    # After its first call it writes a NaN into the Gaussians, where the host does not look.
    "spoils_model": """\
        calls = torch.zeros(())

        def loss(self, step):
            if self.calls:
                rows = step.model._model.parameters
                values = rows.read().clone()
                values[3, 7] = float("nan")
                rows.write(values)
            self.calls = self.calls + 1
            return step.rendering.alpha.mean()

        def state(self):
            return {"calls": self.calls}

        def restore(self, state):
            self.calls = state["calls"]
        """,
}
METRICS = {
    "builtin_name": "return 99.0",
    "writes_rendering": "rendered.copy_(photograph)\nreturn 99.0",
}
PRIORS = {
    "prior_answers_nothing": "pass",
    "prior_answers_too_few": "return []",
    "prior_raises": "raise ValueError('no network')",
}
SOURCES = {
    "exit_at_import": "import sys\nsys.exit(3)\n",
    "hang_at_import": "import time\ntime.sleep(3600)\n",
    "import_error": "1 / 0\n",
    "missing_dependency": "import a_package_that_nobody_has\n",
    "misspelt_hook": plugin("misspelt_hook", loss(""), section="regularisers"),
    "syntax_error": "def loss(self, step:\n",
    "wrong_api": "STEREOGS_API = 99\n" + plugin("wrong_api", loss("")),
    "wrong_dtype": plugin(
        "wrong_dtype",
        "def opacity_scale(self, step):\n"
        "    return torch.ones(step.model.count, dtype=torch.int64)\n",
        section="modifiers",
        base="registry.Modifier",
    ),
    **{name: plugin(name, loss(fault)) for name, fault in IN_A_LOSS.items()},
    **{name: plugin(name, body) for name, body in METHODS.items()},
    **{
        name: plugin(
            "psnr" if name == "builtin_name" else name,
            "def measure(self, rendered, photograph, mask):\n" + textwrap.indent(body, "    "),
            section="metrics",
            base="registry.Metric",
        )
        for name, body in METRICS.items()
    },
    **{
        name: plugin(
            name,
            f"def estimate(self, views, bounds):\n    {body}\n",
            section="priors",
            base="MultiViewDepthPrior",
        )
        for name, body in PRIORS.items()
    },
}
"""The module of each package."""
NAMES = sorted(SOURCES)


def module(name: str) -> str:
    """Return the name of a package's module."""
    return f"faulty_{name}"


def installed(
    names: Sequence[str], site: Path, monkeypatch: pytest.MonkeyPatch
) -> list[EntryPoint]:
    """Put packages on the path with the metadata that pip would write; return their entry points.

    Args:
        site: a folder for modules and metadata.
    """
    for name in names:
        package = f"faulty-{name.replace('_', '-')}"
        entry = "faulty.psnr" if name == "builtin_name" else name
        metadata = site / f"faulty_{name}-6.6.dist-info"
        metadata.mkdir(parents=True)
        (metadata / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {package}\nVersion: 6.6\n"
        )
        (metadata / "top_level.txt").write_text(f"{module(name)}\n")
        (metadata / "entry_points.txt").write_text(f"[{GROUP}]\n{entry} = {module(name)}\n")
        (site / f"{module(name)}.py").write_text(SOURCES[name])
        monkeypatch.delitem(sys.modules, module(name), raising=False)
    monkeypatch.syspath_prepend(site)
    found = [e for d in distributions(path=[str(site)]) for e in d.entry_points if e.group == GROUP]
    return sorted(found, key=lambda entry: entry.name)
