"""Keys depend on all inputs."""

from __future__ import annotations

import json
import logging

import torch

from registry.toolkit.cache import content_key, source_digest


def test_keys_depend_on_types_shapes_and_order() -> None:
    values = torch.arange(6.0)
    keys = [
        content_key(values),
        content_key(values.double()),
        content_key(values.reshape(2, 3)),
        content_key(values, None),
        content_key(None, values),
        content_key(values, "None"),
        content_key(b"None"),
        content_key("None"),
    ]
    assert len(set(keys)) == len(keys)
    assert content_key(values.clone()) == keys[0]


def test_digests_of_code_depend_on_its_file() -> None:
    assert source_digest(json) == source_digest(json.dumps)
    assert source_digest(json) != source_digest(logging)
    assert source_digest(json, logging) != source_digest(logging, json)
