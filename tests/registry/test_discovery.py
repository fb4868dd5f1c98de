"""Tests of `registry.discovery`, which import its modules."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from registry import API_VERSION, PluginError
from registry.discovery import GROUP, SELECTION, Plugins
from tests.host import PIPELINE_POINTS, HookPoint, load_pipeline, parse_pipeline, recognize
from tests.registry.conftest import EXTENSION_POINTS, TOYS, Install

POINTS = {point.section: point for point in PIPELINE_POINTS}
METRICS = POINTS["metrics"]

METRIC = """\
import registry
class {cls}(registry.Metric[registry.Settings]):
    def measure(self, rendered, photograph, mask):
        return 0.0
@registry.hookimpl
def stereogs_register_metrics(register):
    register("{name}", {cls})
"""


def metric(name: str, cls: str = "Score") -> str:
    return METRIC.format(name=name, cls=cls)


def refusal(plugins: Plugins, name: str, point: HookPoint = METRICS) -> PluginError:
    with pytest.raises(PluginError) as caught:
        plugins.find(point, name)
    return caught.value


def test_every_hook_point_collects() -> None:
    toys = Plugins([*TOYS, *EXTENSION_POINTS])
    offers = toys.all()
    assert {offer.point.section for offer in offers} == set(POINTS)
    assert not toys.broken
    assert not toys.conflicts()


def test_tests_see_no_installed_plugins() -> None:
    assert Plugins().entries == ()


def test_a_plugin_is_found_through_its_metadata(install: Install) -> None:
    install("acme-metrics", "1.2", {"sharpness": "acme_sharp"}, acme_sharp=metric("sharpness"))
    offer = Plugins().find(METRICS, "sharpness")
    assert (offer.plugin, offer.distribution, offer.version) == ("sharpness", "acme-metrics", "1.2")
    assert str(offer) == "metric 'sharpness' (acme-metrics 1.2)"


@pytest.mark.parametrize("entry", ["alpha", "metrics.alpha"])
def test_only_the_plugin_that_is_named_is_imported(install: Install, entry: str) -> None:
    install("lazy", "1", {entry: "lazy_a", "beta": "lazy_b"}, lazy_a=metric("alpha"), lazy_b="1/0")
    plugins = Plugins()
    assert "lazy_a" not in sys.modules
    plugins.find(METRICS, "alpha")
    assert "lazy_b" not in sys.modules
    assert not plugins.broken


def test_a_broken_plugin_harms_only_those_who_use_it(install: Install) -> None:
    install("good", "1", {"pack.inside_pack": "good_pack"}, good_pack=metric("inside_pack"))
    install("bad", "3.1", {"monster": "bad_monster"}, bad_monster="import does_not_exist")
    plugins = Plugins()
    assert plugins.find(METRICS, "inside_pack").distribution == "good"
    named = refusal(plugins, "monster")
    assert "monster (bad 3.1)" in named.what
    assert "does_not_exist" in named.what
    assert "monster = bad_monster" in named.where
    elsewhere = refusal(plugins, "inside_pak")
    assert "did you mean 'inside_pack'" in elsewhere.what
    assert "stereogs plugins" in elsewhere.fix


def test_a_misspelt_name_imports_nothing(install: Install) -> None:
    install("calm", "1", {"quiet": "calm_a", "monster": "calm_b"}, calm_a="1/0", calm_b="1/0")
    plugins = Plugins()
    assert "did you mean 'quiet'" in refusal(plugins, "quite").what
    assert not {"calm_a", "calm_b"} & set(sys.modules)
    assert not plugins.broken


def test_a_plugin_that_registers_nothing_is_told_what_may_lack(install: Install) -> None:
    bare = metric("mute").replace("@registry.hookimpl\n", "")
    install("mute", "2", {"mute": "mute_module"}, mute_module=bare)
    error = refusal(Plugins(), "mute")
    assert "mute (mute 2)" in error.what
    assert "@hookimpl" in error.fix


@pytest.mark.parametrize("kind", ["ValueError", "SystemExit"])
def test_even_an_import_that_exits_is_refused_by_name(install: Install, kind: str) -> None:
    install("rude", "1", {"rude": "rude_module"}, rude_module=f"raise {kind}('no GPU')")
    assert f"{kind}: no GPU" in refusal(Plugins(), "rude").what


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("STEREOGS_API = 99\n" + metric("x"), f"needs stereogs API 99, this is API {API_VERSION}"),
        (
            metric("x").replace("_metrics", "_metrix"),
            "no hook 'stereogs_register_metrix'; did you mean 'stereogs_register_metrics'",
        ),
        ("import os\nos.chdir('/')\n" + metric("x"), "changed the working directory"),
        (metric("x").replace("(register)", "(register, more)"), "more"),
        (metric("x").replace("measure", "meazure"), "does not define measure"),
        (
            metric("x").replace("registry.Metric[registry.Settings]", "object"),
            "stereogs.api.ViewMetric",
        ),
        (metric("x").replace("registry.Metric[", "registry.Exporter["), "stereogs.api.ViewMetric"),
        (metric("x y"), "is not a word"),
        (metric("x") + '    register("x", Score)\n', "registered twice"),
        (metric("x").replace("pass", "") + "    raise KeyError('k')\n", "KeyError"),
        (
            metric("x").replace(
                "    def measure",
                "    class Settings(registry.Settings):\n        name: str = ''\n    def measure",
            ),
            "'name', which belongs to the host",
        ),
        (
            metric("x").replace("    def measure", "    Settings = dict\n    def measure"),
            "do not derive from stereogs.api.Settings",
        ),
        (
            metric("x").replace(
                "    def measure", "    host_defaults = '{every: 100}'\n    def measure"
            ),
            "are not a HostDefaults",
        ),
    ],
)
def test_what_the_host_cannot_use_is_refused(install: Install, source: str, message: str) -> None:
    install("faulty", "0.1", {"x": "faulty_module"}, faulty_module=source)
    error = refusal(Plugins(), "x")
    assert message in error.what
    assert "x (faulty 0.1)" in error.what
    assert error.fix


def test_a_setting_named_start_is_fine_where_the_host_lends_no_schedule(install: Install) -> None:
    source = metric("timed").replace(
        "    def measure",
        "    class Settings(registry.Settings):\n        start: int = 0\n    def measure",
    )
    install("timed", "1", {"timed": "timed_module"}, timed_module=source)
    assert Plugins().find(METRICS, "timed").settings_type.model_fields.keys() == {"start"}


def test_two_packages_with_one_name_conflict(install: Install) -> None:
    install("first", "1", {"twin": "twin_a"}, twin_a=metric("twin"))
    install("second", "2", {"other.twin": "twin_b"}, twin_b=metric("twin"))
    error = refusal(Plugins(), "twin")
    assert "first 1" in error.what
    assert "second 2" in error.what
    assert SELECTION in error.fix
    assert "write `use: second/twin`, or another package" in error.fix
    assert [str(e) for e in Plugins().conflicts()] == [str(error)]
    install("third", "3", {"twin": "twin_c"}, twin_c=metric("twin"))
    assert SELECTION not in refusal(Plugins(), "twin").fix, "it cannot tell twin from twin"


def test_the_package_chooses_between_two_of_one_name(install: Install) -> None:
    install("first", "1", {"twin": "twin_a"}, twin_a=metric("twin"))
    install("the_second", "2", {"other.twin": "twin_b"}, twin_b=metric("twin"))
    plugins = Plugins()
    for written in ("the_second/twin", "The-Second/twin"):
        offer = plugins.find(METRICS, written)
        assert (offer.distribution, offer.use) == ("the_second", "the_second/twin")
    assert plugins.find(METRICS, "twin", "first").use == "first/twin"
    assert "offered twice" in refusal(plugins, "twin").what
    assert {offer.use for offer in plugins.all()} == {"first/twin", "the_second/twin"}
    error = refusal(plugins, "third/twin")
    assert "offers no metric 'twin'; installed: the_second/twin, first/twin" in error.what
    assert "offers no metric 'twice'" in refusal(plugins, "first/twice").what


def test_requirements_that_are_not_met_are_named_before_the_import(
    install: Install, caplog: pytest.LogCaptureFixture
) -> None:
    site = install("strict", "1", {"broken": "strict_a"}, strict_a="1/0")
    metadata = site / "strict-1.dist-info" / "METADATA"
    lines = ["numpy<1", "numpy>=1", "no-such-thing>=2", "gone; extra == 'more'", "pluggy"]
    required = "".join(f"Requires-Dist: {line}\n" for line in lines)
    metadata.write_text(metadata.read_text() + required)
    refusal(Plugins(), "broken")
    told = caplog.messages[0]
    assert told.startswith("the package strict 1 requires numpy<1, but numpy ")
    assert "no-such-thing>=2, which is not installed" in told
    assert "pluggy" not in told
    assert "gone" not in told


LOADER = """\
from pathlib import Path
import registry
class Loader(registry.SceneLoader[registry.Settings]):
    @classmethod
    def recognizes(cls, folder):
        return True
    def load(self):
        raise AssertionError
@registry.hookimpl
def stereogs_register_scenes(register):
    register("{name}", Loader)
"""


@pytest.mark.parametrize("name", ["greedy", "photos"])
def test_a_loader_of_another_package_never_outranks_one_of_this_project(
    install: Install, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str
) -> None:
    install("greedy", "1", {name: "greedy_a"}, greedy_a=LOADER.format(name=name))
    assert recognize(tmp_path, Plugins()).distribution == "greedy", "it is the only one"
    monkeypatch.delenv(SELECTION)
    for k in range(3):
        (tmp_path / f"{k}.png").write_bytes(b"")
    own = recognize(tmp_path, Plugins())
    assert own.distribution == "stereogs-plugins"
    assert own.use == ("photos" if name == "greedy" else "stereogs-plugins/photos")


def test_ready_pipelines_mean_the_components_of_their_package(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    install("rival", "1", {"psnr": "rival_a"}, rival_a=metric("psnr"))
    monkeypatch.delenv(SELECTION)
    plugins, scene = Plugins(), ["scene={use: procedural}"]
    ready = load_pipeline(Path("3dgs_fast"), plugins, overrides=scene)
    (psnr,) = (item for item in ready.items["metrics"] if item.name == "psnr")
    assert psnr.offer.distribution == "stereogs-plugins"
    again = parse_pipeline(ready.to_yaml(), plugins)
    assert again.to_yaml() == ready.to_yaml()
    assert "use: stereogs-plugins/psnr" in ready.to_yaml()
    with pytest.raises(PluginError, match="offered twice"):
        load_pipeline(Path("3dgs_fast"), plugins, overrides=[*scene, "metrics=[psnr]"])
    changed = load_pipeline(
        Path("3dgs_fast"),
        plugins,
        overrides=[*scene, "metrics=[rival/psnr, ssim]"],
        disabled=["psnr"],
    )
    assert [item.name for item in changed.items["metrics"]] == ["ssim"]


@pytest.mark.parametrize("first", ["mine", "twin"])
def test_an_entry_offers_nothing_but_what_it_is_named_after(install: Install, first: str) -> None:
    install("stranger", "3", {"mine": "stranger_a"}, stranger_a=metric("twin"))
    install("owner", "1", {"twin": "owner_a"}, owner_a=metric("twin", "Owned"))
    plugins = Plugins()
    if first == "mine":
        refusal(plugins, "mine")
    assert plugins.find(METRICS, "twin").distribution == "owner", "whatever was imported before"
    error = refusal(plugins, "mine")
    assert "registers the metric 'twin', but no entry point of stranger" in error.what
    assert 'add `twin = "stranger_a"`' in error.fix
    install("honest", "1", {"too.twin": "honest_a"}, honest_a=metric("twin", "Other"))
    assert "offered twice" in refusal(Plugins(), "twin").what


def test_an_entry_whose_name_is_not_registered_is_a_fault_of_its_package(install: Install) -> None:
    source = metric("right")
    install("late", "1", {"wrong": "late_a", "right": "late_a"}, late_a=source)
    plugins = Plugins()
    assert plugins.find(METRICS, "right").distribution == "late"
    plugins.all()
    (fault,) = plugins.broken.values()
    assert "its entry point is named 'wrong', but late_a registers right" in fault.what
    assert "register 'wrong'" in fault.fix


def test_a_module_of_several_components_is_imported_for_each_alone(install: Install) -> None:
    source = metric("one") + '    register("two", Score)\n'
    install("duo", "1", {"one": "duo_a", "two": "duo_a", "far": "duo_b"}, duo_a=source, duo_b="1/0")
    plugins = Plugins()
    assert [plugins.find(METRICS, name).plugin for name in ("two", "one")] == ["two", "one"]
    assert "duo_b" not in sys.modules
    assert [offer.name for offer in plugins.all()] == ["one", "two"]


def test_one_name_at_two_hook_points_is_no_conflict(install: Install) -> None:
    source = metric("same") + (
        "class Out(registry.Exporter[registry.Settings]):\n"
        "    def export(self, model, scene, folder):\n        return []\n"
        "@registry.hookimpl\ndef stereogs_register_exporters(register):\n"
        "    register('same', Out)\n"
    )
    install("both", "1", {"same": "both_module"}, both_module=source)
    plugins = Plugins()
    assert plugins.find(METRICS, "same").component.__name__ == "Score"
    assert plugins.find(POINTS["exporters"], "same").component.__name__ == "Out"


def test_selection(install: Install, monkeypatch: pytest.MonkeyPatch) -> None:
    install("sel", "1", {"sel_one": "sel_a", "sel_two": "sel_b"}, sel_a="", sel_b="")
    assert [e.name for e in Plugins().entries] == ["sel_one", "sel_two"]
    monkeypatch.setenv(SELECTION, " sel_two ,")
    assert [e.name for e in Plugins().entries] == ["sel_two"]
    monkeypatch.setenv(SELECTION, "")
    assert Plugins().entries == ()
    monkeypatch.delenv(SELECTION)
    assert {"sel_one", "sel_two"} <= {e.name for e in Plugins().entries}
    monkeypatch.setenv(SELECTION, "sel_too")
    with pytest.raises(PluginError, match="did you mean 'sel_two'") as caught:
        Plugins()
    assert SELECTION in caught.value.where


def test_no_plugins_at_all() -> None:
    assert SELECTION in refusal(Plugins(), "psnr").fix


def test_an_entry_without_a_package_still_has_a_name() -> None:
    plugins = Plugins([*TOYS, EntryPoint("gone", "no_such_module_anywhere", GROUP)])
    assert "gone (unknown package ?)" in refusal(plugins, "gone").what
