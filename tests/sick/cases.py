"""The faults, by family."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Case:
    """A component that does one thing that it must not do.

    Args:
        section: of the pipeline.
        fault: statement in the component's method; the twin leaves it out.
        answer: expression that the method returns; "": the template's.
        compared: the run that must end in the same numbers: the component without the fault, or the same
            component in another process.
        iterations: of training.
    """

    section: str
    fault: str = "pass"
    answer: str = ""
    compared: Literal["twin", "again"] = "twin"
    iterations: int = 12

    @property
    def name(self) -> str:
        """Unique, and readable in a table."""
        what = self.fault if self.fault != "pass" else f"return {self.answer}"
        return f"{self.section}: {what}"


WAYS = {
    "torch": "{}.detach().mul_(.5)",
    "numpy": "{}.detach().numpy()[:] *= .5",
    "data": "{}.data.mul_(.5)",
}
STEP = (
    *("step.view.image", "step.sample.target", "step.scene.train[1].image"),
    *("step.view.camera.world_to_camera", "step.scene.points.positions"),
)
RENDERS = ("step.rendering.rgb", "step.rendering.depth", "step.rendering.alpha")


def writes_of_a_loss() -> Iterator[Case]:
    """Writes into everything that a loss receives, in its first call and in a later one."""
    for way in WAYS.values():
        for target in (*STEP, *RENDERS):
            yield Case("regularizers", way.format(target))
            yield Case("regularizers", f"if self.called == 4: {way.format(target)}")


def writes_of_others() -> Iterator[Case]:
    """Writes of the other kinds."""
    for section in (
        *("samplers", "modifiers", "appearances", "densification", "opacity", "perturbations"),
    ):
        for way in ("torch", "numpy"):
            yield Case(section, WAYS[way].format("step.view.image"))
    for target in ("rendered", "photograph"):
        for way in WAYS.values():
            yield Case("metrics", way.format(target))
    yield Case("metrics", "rendered.copy_(photograph)")
    for target in (
        *(
            "done.target",
            "done.rendering.rgb",
            "done.view.image",
            "done.view.camera.world_to_camera",
        ),
    ):
        yield Case("observers", WAYS["torch"].format(target))
        yield Case("observers", WAYS["numpy"].format(target))
    for section in ("exporters", "reports", "initializer"):
        for way in WAYS.values():
            yield Case(section, way.format("scene.train[0].image"))


BACKWARD = (
    "step.rendering.rgb.mean().backward()",
    "step.rendering.rgb.mean().backward(retain_graph=True)",
    "step.parameter('means').sum().backward()",
    "step.render(step.view.camera).rgb.mean().backward()",
    "step.rendering.rgb.register_hook(lambda g: g * .1)",
    "step.rendering.depth.register_hook(lambda g: g * .1)",
    "step.rendering.alpha.register_hook(lambda g: g * .1)",
    "if self.called == 4: step.rendering.rgb.register_hook(lambda g: g * .1)",
    "step.rendering.rgb.requires_grad_(False)",
    "step.rendering.rgb.detach_()",
)
IN_A_HOOK = (
    "step.view.image.fill_(.5)",
    "step.view.image.numpy().fill(.5)",
    "step.sample.target.zero_()",
    "sys.exit(0)",
    "(_ for _ in ()).throw(BaseException('panic'))",
    "1 / 0",
)
LOSSES = (
    "torch.tensor(float(step.rendering.alpha.detach().mean()), requires_grad=True)",
    "torch.tensor(float(step.rendering.alpha.detach().mean()), requires_grad=True) * 2",
    "torch.nn.Parameter(torch.ones(()))",
    "torch.from_numpy(step.rendering.alpha.detach().numpy()).requires_grad_().mean()",
    "step.rendering.alpha.mean().detach()",
    "step.model.opacities().mean()",
    "float(step.rendering.alpha.detach().mean())",
    "step.rendering.alpha.mean() * float('nan')",
    "step.rendering.alpha.mean() * float('inf')",
    "step.rendering.alpha",
    "step.rendering.alpha.mean() > 0",
    "None",
    "'0.5'",
)
COLORS = (
    "rgb.detach()",
    "rgb.detach() * self.gain",
    "torch.nn.Parameter(rgb.detach().clone())",
    "rgb[..., :2]",
    "rgb * float('nan')",
    "rgb.detach().numpy()",
    "None",
)
SAMPLES = (
    "replace(sample, background=(float('nan'), 0.0, 0.0))",
    "replace(sample, background=(0.0, 0.0))",
    "replace(sample, background=(2.0, 0.0, 0.0))",
    "replace(sample, background=('0', 0.0, 0.0))",
    "replace(sample, target=sample.target * 2)",
    "replace(sample, target=sample.target * float('nan'))",
    "replace(sample, target=sample.target[:5])",
    "replace(sample, sh_degree=-1.0)",
    "replace(sample, sh_degree=float('nan'))",
    "replace(sample, smoothing=torch.full((step.model.count,), -1.0))",
    "None",
)
OTHER_ANSWERS = (
    ("modifiers", "torch.full((step.model.count,), float('nan'))"),
    ("modifiers", "torch.full((step.model.count,), -1.0)"),
    ("modifiers", "torch.ones(3)"),
    ("opacity", "registry.OpacityUpdate(step.model.opacities(), 'yes')"),
    ("opacity", "registry.OpacityUpdate(step.model.opacities() * 2)"),
    ("opacity", "step.model.opacities()"),
    ("densification", "Edit(clone=torch.ones(3, dtype=torch.bool))"),
    ("densification", "Edit(prune=torch.ones(step.model.count, dtype=torch.bool))"),
    ("densification", "'grow'"),
    ("perturbations", "{'means': torch.full((step.model.count, 3), float('nan'))}"),
    ("perturbations", "{'nonsense': torch.zeros(3)}"),
    ("metrics", "float('nan')"),
    ("metrics", "'3.0'"),
    ("metrics", "True"),
    ("metrics", "None"),
    ("metrics", "registry.Unavailable(3)"),
    ("metrics", "registry.Unavailable('\\x1b[31m')"),
    ("exporters", "[folder / 'missing.txt']"),
    ("exporters", "'a.txt'"),
    ("exporters", "[self.written(folder / '\\x1b[31m.txt')]"),
    ("reports", "[self.written(folder / '\\u202e.txt')]"),
    ("initializer", "replace(points, facts={'a': object()})"),
    ("initializer", "replace(points, facts={'a': '\\x1b[31m'})"),
    ("initializer", "replace(points, facts={3: 'a'})"),
    ("initializer", "replace(points, maps={'nowhere': DepthMap(*3 * [torch.ones(24, 32)])})"),
    ("initializer", "replace(points, maps={'view0': DepthMap(*3 * [torch.ones(3, 3)])})"),
    ("initializer", "replace(points, positions=points.positions * float('nan'))"),
)
PROCESS = (
    "os.chdir('/')",
    "torch.set_grad_enabled(False)",
    "torch.set_default_dtype(torch.float64)",
    "torch.set_default_device('meta')",
    "torch.set_num_threads(2)",
    "torch.manual_seed(1)",
    "np.random.seed(1)",
    "random.seed(1)",
    "np.seterr(all='raise')",
    "warnings.simplefilter('error')",
    "os.environ['TZ'] = 'x'",
    "os.umask(0)",
    "sys.setrecursionlimit(5000)",
    "signal.signal(signal.SIGUSR2, signal.SIG_IGN)",
    "threading.Thread(target=time.sleep, args=(.3,)).start()",
    "sys.exit(0)",
)
UNREPEATABLE = (
    "torch.rand(())",
    "np.random.rand()",
    "random.random()",
    "np.random.default_rng().random()",
    "random.SystemRandom().random()",
    "int.from_bytes(os.urandom(2), 'big')",
    "time.time() % 1",
    "time.perf_counter() % 1",
    "id(object()) % 1000",
    "os.getpid() % 1000",
    "hash('text') % 1000",
    "list({'a', 'b', 'c', 'd', 'e'}).index('a')",
)


ODD_WRITES = (
    ("regularizers", "step.model.read('means').mul_(.5)"),
    ("regularizers", "step.model.opacities().mul_(.5)"),
    ("regularizers", "step.parameter('means').data.mul_(.5)"),
    ("regularizers", "step.render(step.view.camera).rgb.detach().mul_(.5)"),
    ("regularizers", "step.view.image.resize_(2, 2, 3)"),
    ("regularizers", "step.view.image.set_(torch.zeros(24, 32, 3))"),
    ("regularizers", "step.view.image.requires_grad_(True)"),
    ("regularizers", "np.clip(step.view.image.numpy(), .2, .8, out=step.view.image.numpy())"),
    ("regularizers", "step.learning_rates['means'] = 0"),
    ("densification", "step.model.read('means').zero_()"),
    ("opacity", "step.model.read('opacity_logits').zero_()"),
    ("perturbations", "step.model.read('means').mul_(.5)"),
    ("metrics", "rendered.resize_(2, 2, 3)"),
    ("metrics", "torch.manual_seed(3)"),
    ("observers", "done.model.read('means').mul_(.5)"),
    ("observers", "done.numbers.clear()"),
    ("observers", "torch.rand(3)"),
    ("exporters", "model.gaussians().means.mul_(.5)"),
    ("exporters", "model.write('means', model.read('means') * 0)"),
    ("exporters", "(folder.parent / 'results.json').write_text('{}')"),
    ("reports", "(folder / 'results.json').write_text('{}')"),
)
ODD_ANSWERS = (
    ("appearances", "rgb.mul_(1.1)"),
    ("samplers", "replace(sample, target=sample.target.mul_(.5))"),
    ("initializer", "replace(points, colors=points.colors * 255)"),
    ("initializer", "replace(points, positions=points.positions.mul_(1.01))"),
    ("initializer", "replace(points, positions=points.positions.requires_grad_())"),
)
KEPT = (
    ("self.kept = getattr(self, 'kept', step.rendering.alpha)", "self.kept.mean()"),
    ("type(self).called += 1", "step.rendering.alpha.mean() * type(self).called"),
)
"""Regularizers that keep a render of an earlier iteration, and numbers of all runs of the process."""
OWN_GENERATOR = (
    "self.own = getattr(self, 'own', None) or np.random.default_rng()",
    "step.rendering.alpha.mean() * self.own.random()",
)


FACTORS = {
    "regularizers": "step.rendering.alpha.mean() * ({})",
    "modifiers": "torch.full((step.model.count,), 0.5 + 0.4 * float(({}) % 1000) / 1000)",
    "initializer": "replace(points, positions=points.positions * (1 + float({}) * 1e-3))",
    "metrics": "float({})",
}


def all_cases() -> list[Case]:
    """Return every case."""
    cases = [*writes_of_a_loss(), *writes_of_others()]
    cases += [Case("regularizers", fault) for fault in BACKWARD]
    for inner in IN_A_HOOK:
        cases.append(Case("regularizers", f"self.hook = lambda g: {inner} and None"))
    cases += [Case("regularizers", answer=answer) for answer in LOSSES]
    cases += [Case("appearances", answer=answer) for answer in COLORS]
    cases += [Case("samplers", answer=answer) for answer in SAMPLES]
    cases += [Case(section, answer=answer) for section, answer in OTHER_ANSWERS]
    cases += [Case("regularizers", fault) for fault in PROCESS]
    for factor in UNREPEATABLE:
        for section, answer in FACTORS.items():
            cases.append(Case(section, answer=answer.format(factor), compared="again"))
    cases += [Case(section, fault) for section, fault in ODD_WRITES]
    cases += [Case(section, answer=answer) for section, answer in ODD_ANSWERS]
    cases += [Case("regularizers", *kept) for kept in KEPT]
    cases.append(Case("regularizers", *OWN_GENERATOR, compared="again"))
    rare = "step.rendering.alpha.mean() * (torch.rand(()) if step.iteration % 10 == 3 else 1)"
    cases.append(Case("regularizers", answer=rare, iterations=40))
    return cases
