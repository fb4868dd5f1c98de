"""Files for a public host agree with those that a contributor uses."""

from __future__ import annotations

import re

import yaml

from tests.release.distributions import ROOT


def test_pre_commit_has_the_versions_of_make() -> None:
    pinned = dict(
        line.split("==")
        for line in (ROOT / "constraints.txt").read_text("utf-8").splitlines()
        if "==" in line
    )
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text("utf-8"))["repos"]
    for hook in hooks:
        package = (
            hook["repo"].rpartition("/")[2].removesuffix("-pre-commit").removeprefix("mirrors-")
        )
        assert hook["rev"].removeprefix("v") == pinned[package]


def test_workflows_make_what_there_is() -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    targets = set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))
    ci, publish = (
        yaml.safe_load((ROOT / ".github" / "workflows" / f"{name}.yml").read_text("utf-8"))["jobs"]
        for name in ("ci", "publish")
    )
    made = " ".join(ci["checks"]["strategy"]["matrix"]["target"]).split()
    made += re.findall(r"make (\S+)", str(publish))
    assert len(made) == 5
    assert set(made) <= targets
