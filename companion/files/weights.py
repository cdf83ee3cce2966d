"""Strict reading of weights files: damaged weights would steer a vehicle wrongly without any error.

A weights file is JSON with an object `network`, the record of its training, and a digest of both. Whatever is missing,
damaged or of another shape is refused in one line (InputError) that names file, key and what is allowed.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from companion.errors import InputError

DIGEST_KEY = "sha256"
"""Key of a weights file that holds the digest of the rest."""


def content_digest(content: dict[str, Any]) -> str:
    """Return the SHA-256, in hex, of a weights file's content without its digest, written as canonical JSON.

    Canonical JSON has sorted keys, no white space, and numbers as Python writes them: a reformatted file keeps its
    digest.
    """
    body = {key: value for key, value in content.items() if key != DIGEST_KEY}
    return hashlib.sha256(json.dumps(body, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


@dataclass(frozen=True)
class WeightsFile:
    """The `network` of a weights file whose digest is right; methods return checked values or raise InputError."""

    source: str
    """Name of the file in error messages."""
    network: dict[str, Any]

    def count(self, key: str) -> int:
        """Return the value of a key that must be a whole number of at least 1."""
        value = self.network.get(key)
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            raise InputError(f"{self.source}: key 'network.{key}' is {value!r}, allowed: a whole number, at least 1")
        return value

    def number(self, key: str) -> float:
        """Return the value of a key that must be a finite number."""
        value = self.network.get(key)
        if not _is_finite_number(value):
            raise InputError(f"{self.source}: key 'network.{key}' is {value!r}, allowed: a finite number")
        return value

    def per_neuron(self, keys: Sequence[str]) -> dict[str, np.ndarray]:
        """Return by key the lists that must hold one finite number for each of the J hidden neurons, as arrays (J,)."""
        vectors = {key: self._finite(key, self.network.get(key)) for key in keys}
        neurons = len(vectors[keys[0]])
        for key, vector in vectors.items():
            if len(vector) != neurons or neurons == 0:
                raise InputError(
                    f"{self.source}: key 'network.{key}' has {len(vector)} numbers, allowed: one per hidden neuron, "
                    f"as many as '{keys[0]}' ({neurons}), at least 1"
                )
        return vectors

    def matrix(self, key: str, rows: int, columns: int) -> np.ndarray:
        """Return the value of a key, `rows` lists of `columns` finite numbers each, as an array (rows, columns)."""
        lists = self.network.get(key)
        lists = lists if isinstance(lists, list) else []
        lengths = [len(row) if isinstance(row, list) else 0 for row in lists]
        if lengths != [columns] * rows:
            raise InputError(
                f"{self.source}: key 'network.{key}' is damaged, allowed: {rows} lists of {columns} numbers"
            )
        return np.array([self._finite(key, row) for row in lists])

    def _finite(self, key: str, values: object) -> np.ndarray:
        if not isinstance(values, list) or not all(_is_finite_number(value) for value in values):
            raise InputError(f"{self.source}: key 'network.{key}' is damaged, allowed: a list of finite numbers")
        return np.array(values, dtype=float)


def read_weights(path: Path | None, packaged: str) -> WeightsFile:
    """Return the network of the weights file at `path`, or if that is None of the packaged file called `packaged`.

    Raises InputError if the file is missing, is not JSON, has no network or does not match its digest.
    """
    source = resources.files("companion.surrogate").joinpath("weights", packaged) if path is None else path
    try:
        content = json.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{source}: cannot read the weights: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{source}: not a JSON file: {error}") from error
    if not isinstance(content, dict) or not isinstance(content.get("network"), dict):
        raise InputError(f"{source}: key 'network' is missing, allowed: an object as `companion train` writes it")
    digest = content_digest(content)
    if content.get(DIGEST_KEY) != digest:
        raise InputError(
            f"{source}: key '{DIGEST_KEY}' is {content.get(DIGEST_KEY)!r}, allowed: the digest of the content, "
            f"{digest}; the file is damaged or was edited"
        )
    return WeightsFile(str(source), content["network"])


def _is_finite_number(value: object) -> TypeGuard[float]:
    return isinstance(value, float) and math.isfinite(value)
