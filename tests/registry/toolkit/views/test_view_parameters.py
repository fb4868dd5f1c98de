from __future__ import annotations

import torch

from registry.testing import tiny_scene
from registry.toolkit.views import ViewParameters


def test_each_view_has_its_own_relative_to_the_mean() -> None:
    views = tiny_scene().for_training()
    numbers = ViewParameters(views, (2, 3))
    group = numbers.group("numbers", 0.1)
    assert (group.name, group.learning_rate, len(group.tensors)) == ("numbers", 0.1, 2)
    assert not any(bool(tensor.any()) for tensor in group.tensors)
    with torch.no_grad():
        group.tensors[0].fill_(1.0)
        group.tensors[1].fill_(4.0)
    first, second = (numbers.of(view) for view in views.train)
    assert (first == -1.5).all()
    assert (second == 1.5).all()
    second.sum().backward()
    assert group.tensors[0].grad is None
    assert group.tensors[1].grad is not None
    assert (group.tensors[1].grad == 1).all()
