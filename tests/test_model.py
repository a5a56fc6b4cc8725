"""ShapeModel: fit, predict, generate, tables, files."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import accel_shapegen as asg
from accel_shapegen import Box, FourierLattice, Grid, ScatteredNodes, ShapeModel
from accel_shapegen.backends.base import Backend
from accel_shapegen.errors import (
    ArgumentError,
    BackendError,
    DtypeError,
    KnotError,
    MissingFileError,
    ModelFileError,
    NonFiniteError,
    QueryRangeError,
    ShapeError,
    TableError,
)
from accel_shapegen.testing import relative_error

LATTICE = FourierLattice(Box((2.0, 3.0)), (2, 3))
KNOTS = (np.array([1.0, 1.5, 2.0, 2.5]), np.linspace(0, 1, 11), np.array([-1.0, 0.0, 4.0]))
QUERIES = np.array([[1.1, 0.33, 0.5], [2.5, 0.0, 4.0], [1.75, 0.91, -0.2]])


def generators(knots, nodes, rng, dtype="complex128") -> np.ndarray:
    shape = (*map(len, knots), *nodes.shape)
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(dtype)


def scipy_tensor_spline(knots, u, query, boundary, derivative=None) -> np.ndarray:
    """Tensor product of 1-D splines, contracted axis by axis."""
    for axis, (points, value) in enumerate(zip(knots, query, strict=True)):
        u = CubicSpline(points, u, axis=0, bc_type=boundary)(value, nu=int(axis == derivative))
    return u


@pytest.mark.parametrize("boundary", ["natural", "not-a-knot", "clamped"])
@pytest.mark.parametrize("dtype", ["complex64", "complex128"])
def test_predict_is_scipys_tensor_spline(opencl: Backend, boundary, dtype: str, rng: np.random.Generator) -> None:
    u = generators(KNOTS, LATTICE, rng, dtype)
    model = ShapeModel.fit(KNOTS, u, LATTICE, boundary=boundary, backend=opencl)
    predicted = model.predict(QUERIES)
    assert predicted.dtype == dtype
    assert predicted.shape == (3, *LATTICE.shape)
    # Weights of a spline with knots spaced 4 : 1 reach about 3; hundreds of terms: tens of eps.
    tolerance = 100 * np.finfo(dtype).eps
    for row, query in zip(predicted, QUERIES, strict=True):
        assert relative_error(row, scipy_tensor_spline(KNOTS, u, query, boundary)) < tolerance
    for axis in range(3):
        slope = model.predict(QUERIES[0], derivative=axis)
        exact = scipy_tensor_spline(KNOTS, u, QUERIES[0], boundary, axis)
        assert relative_error(slope, exact) < tolerance


def test_interpolates_at_every_knot(opencl: Backend, rng: np.random.Generator) -> None:
    u = generators(KNOTS, LATTICE, rng)
    model = ShapeModel.fit(KNOTS, u, LATTICE, backend=opencl)
    grid = np.array(list(product(*KNOTS)))
    assert relative_error(model.predict(grid), u.reshape(-1, *LATTICE.shape)) < 100 * np.finfo(float).eps
    few = ShapeModel.fit(KNOTS[::2], u[:, 0], LATTICE, backend=opencl)
    # Up to eight knots per axis the weights at a knot are exactly 0 and 1.
    np.testing.assert_array_equal(
        few.predict(grid.reshape(4, 11, 3, 3)[:, 0, :, ::2].reshape(-1, 2)).reshape(4, 3, *LATTICE.shape), u[:, 0]
    )


def test_models_one_and_two_agree(rng: np.random.Generator) -> None:
    knots = (np.linspace(0, 1, 5), np.linspace(1, 3, 12))
    u = generators(knots, LATTICE, rng)
    queries = rng.uniform((0, 1), (1, 3), size=(9, 2))
    one, two = (ShapeModel.fit(knots, u, LATTICE, basis=basis) for basis in ("cox-de-boor", "uniform"))
    assert relative_error(one.predict(queries), two.predict(queries)) < 100 * np.finfo(float).eps


def test_prediction_is_linear_and_independent_of_its_batch(opencl: Backend, rng: np.random.Generator) -> None:
    a, b = generators(KNOTS, LATTICE, rng), generators(KNOTS, LATTICE, rng)
    fit = [ShapeModel.fit(KNOTS, u, LATTICE, backend=opencl).predict(QUERIES) for u in (a, b, 2 * a - 3 * b)]
    assert relative_error(fit[2], 2 * fit[0] - 3 * fit[1]) < 100 * np.finfo(float).eps
    model = ShapeModel.fit(KNOTS, a, LATTICE, backend=opencl)
    np.testing.assert_array_equal(model.predict(QUERIES[1]), model.predict(QUERIES)[1])


def test_byte_order_does_not_matter(rng: np.random.Generator) -> None:
    u = generators(KNOTS[:1], LATTICE, rng)
    native, swapped = (ShapeModel.fit(KNOTS[:1], data, LATTICE).predict([[1.7]]) for data in (u, u.astype(">c16")))
    np.testing.assert_array_equal(swapped, native)
    grid = Grid(Box((1.0, 1.0)), 4)
    field = asg.synthesize(native.astype(">c16"), LATTICE, grid)
    np.testing.assert_array_equal(field, asg.synthesize(native, LATTICE, grid))


def test_extrapolates_along_the_tangent(rng: np.random.Generator) -> None:
    u = generators(KNOTS[:1], LATTICE, rng)
    model = ShapeModel.fit(KNOTS[:1], u, LATTICE)
    spline = CubicSpline(KNOTS[0], u, bc_type="natural")
    outside = model.predict([[3.0], [0.0]], extrapolate="linear")
    assert relative_error(outside[0], spline(2.5) + 0.5 * spline(2.5, 1)) < 1e-13
    assert relative_error(outside[1], spline(1.0) - spline(1.0, 1)) < 1e-13


def test_scattered_nodes_have_models_too(rng: np.random.Generator) -> None:
    nodes = ScatteredNodes([[1.0, 0.0], [0.6, 0.8], [0.0, -1.0]], [1.0, 2.0, 3.0])
    u = generators(KNOTS[:1], nodes, rng)
    model = ShapeModel.fit(KNOTS[:1], u, nodes, names=["height"])
    np.testing.assert_array_equal(model.predict(KNOTS[0][:, None]), u)
    with pytest.raises(ArgumentError, match="model: is over scattered nodes"):
        model.generate([[1.0]], Grid(Box((1, 1)), 3))


def test_generate_is_predict_then_synthesise(rng: np.random.Generator) -> None:
    u = generators(KNOTS, LATTICE, rng, "complex64")
    model = ShapeModel.fit(KNOTS, u, LATTICE)
    grid = Grid(Box((2.5, 3.0)), (9, 8))
    seen = []
    fields = model.generate(
        QUERIES, grid, batch=2, window="lanczos", progress=lambda done, total: seen.append((done, total))
    )
    expected = asg.synthesize(model.predict(QUERIES), LATTICE, grid, window="lanczos")
    np.testing.assert_array_equal(fields, expected)
    assert seen == [(2, 3), (3, 3)]
    out = np.empty_like(fields)
    assert model.generate(QUERIES, grid, window="lanczos", out=out) is out
    np.testing.assert_array_equal(out, fields)
    np.testing.assert_array_equal(model.generate(QUERIES[2], grid, window="lanczos"), fields[2])


def test_kites_come_back() -> None:
    """The two-parameter kites, from their exact far fields, at the four queries: every body within a cell or so."""
    values = np.linspace(0.5, 1.8, 14)
    lattice = FourierLattice(Box((7.0, 7.0)), 20)
    bodies = [asg.bodies.kite(float(b1), float(b2), segments=256) for b1, b2 in product(values, values)]
    model = ShapeModel.fit_bodies((values, values), bodies, lattice, names=["beta1", "beta2"])
    grid = Grid(lattice.box, 400)
    queries = [(0.93, 1.76), (1.58, 0.87), (0.95, 0.95), (1.65, 1.65)]
    for query, field in zip(queries, model.generate(np.array(queries), grid), strict=True):
        exact = asg.voxelize(asg.bodies.kite(*query), grid).values
        assert asg.metrics.iou(field > 0.5, exact) >= 0.993


def test_tables_in_any_order(rng: np.random.Generator) -> None:
    """Five heights by four weights: row 8 of the table in C order is U_{2,4} counted from 1."""
    heights, weights = np.linspace(1.5, 1.9, 5), np.linspace(0.6, 1.4, 4)
    table = np.array(list(product(heights, weights)))
    bodies = [asg.bodies.kite(float(h) / 2, float(w) / 2) for h, w in table]
    lattice = FourierLattice(Box((7.0, 7.0)), 3)
    u = asg.far_field(bodies, lattice)
    np.testing.assert_array_equal(u.reshape(5, 4, *lattice.shape)[1, 3], u[7])
    expected = ShapeModel.fit((heights, weights), u.reshape(5, 4, *lattice.shape), lattice)
    shuffled = rng.permutation(20)
    from_u = ShapeModel.from_table(table[shuffled], u[shuffled], lattice, names=["height", "rw"])
    from_bodies = ShapeModel.from_table(table[shuffled], [bodies[i] for i in shuffled], lattice)
    for model in (from_u, from_bodies):
        np.testing.assert_array_equal(model.coefficients, expected.coefficients)
    assert from_u.names == ("height", "rw")
    with pytest.raises(TableError, match=r"1 grid points are missing: \(height=1\.5, rw=0\.6\)"):
        ShapeModel.from_table(table[1:], u[1:], lattice, names=["height", "rw"])
    with pytest.raises(TableError, match=r"1 grid points are repeated: \(lambda_1=1\.5, lambda_2=0\.6\)"):
        ShapeModel.from_table(np.vstack([table, table[:1]]), np.concatenate([u, u[:1]]), lattice)
    with pytest.raises(ShapeError, match="bodies_or_u: has 19 rows"):
        ShapeModel.from_table(table, u[1:], lattice)


@pytest.mark.parametrize("kind", ["lattice", "scattered"])
def test_saved_model_answers_with_the_same_bits(
    opencl: Backend, tmp_path: Path, kind: str, rng: np.random.Generator
) -> None:
    nodes = LATTICE if kind == "lattice" else ScatteredNodes([[1.0, 0.0], [0.6, 0.8]], [1.0, 2.0])
    model = ShapeModel.fit(
        KNOTS,
        generators(KNOTS, nodes, rng, "complex64"),
        nodes,
        boundary="clamped",
        names=["höhe", "rw", "c"],
        backend=opencl,
    )
    path = model.save(tmp_path / "model.npz")
    again = ShapeModel.load(path, backend=opencl)
    np.testing.assert_array_equal(again.predict(QUERIES), model.predict(QUERIES))
    assert again.names == model.names
    assert again.nodes == nodes or kind == "scattered"
    np.testing.assert_array_equal(again.nodes.kappa, nodes.kappa)
    assert [p.name for p in tmp_path.iterdir()] == ["model.npz"]
    with np.load(path, allow_pickle=False) as plain:
        np.testing.assert_array_equal(plain["coefficients"], model.coefficients)


def test_any_flipped_bit_and_any_cut_is_found(tmp_path: Path, rng: np.random.Generator) -> None:
    model = ShapeModel.fit(KNOTS[:1], generators(KNOTS[:1], LATTICE, rng, "complex64"), LATTICE)
    whole = model.save(tmp_path / "model.npz").read_bytes()
    damaged = tmp_path / "damaged.npz"
    for place in range(len(whole)):
        bad = bytearray(whole)
        bad[place] ^= 1 << int(rng.integers(8))
        damaged.write_bytes(bad)
        with pytest.raises(ModelFileError, match=r"damaged\.npz"):
            ShapeModel.load(damaged)
    for length in range(len(whole)):
        damaged.write_bytes(whole[:length])
        with pytest.raises(ModelFileError, match=r"damaged\.npz"):
            ShapeModel.load(damaged)


def test_unreadable_models(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="does not exist"):
        ShapeModel.load(tmp_path / "none.npz")
    with pytest.raises(ModelFileError, match="is not a file"):
        ShapeModel.load(tmp_path)
    np.savez(tmp_path / "other.npz", a=np.arange(100))
    with pytest.raises(ModelFileError, match="is cut short, or is not a model"):
        ShapeModel.load(tmp_path / "other.npz")


def member(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def with_header(**changes):
    def change(members: dict[str, bytes]) -> None:
        header = json.loads(np.load(io.BytesIO(members["header.npy"])).tobytes())
        members["header.npy"] = member(np.frombuffer(json.dumps({**header, **changes}).encode(), dtype=np.uint8))

    return change


def with_member(name: str, array: np.ndarray):
    return lambda members: members.update({f"{name}.npy": member(array)})


HUGE = {"kind": "lattice", "box": [1, 1], "order": [10**6, 10**6], "mu": 0.1}


@pytest.mark.parametrize(
    "forge",
    [
        with_member("coefficients", np.ones((3, *LATTICE.shape), complex)),
        with_member("coefficients", np.ones((4, *LATTICE.shape))),
        with_member("coefficients", np.full((4, *LATTICE.shape), np.nan + 0j)),
        with_member("coefficients", np.array([{}], dtype=object)),
        with_member("coefficients", np.ones((4, *LATTICE.shape), dtype=">c16")),
        with_member("header", np.frombuffer(b"[" * 100_000, dtype=np.uint8)),
        with_member("knots_0", np.array([0, np.nan, 2.0, 3.0])),
        with_member("knots_0", np.arange(5.0)),
        with_member("header", np.frombuffer(b"[1, 2]", dtype=np.uint8)),
        lambda members: members.pop("knots_0.npy"),
        lambda members: members.update({"header.npy": b"junk"}),
        with_header(axes=[]),
        with_header(axes=3),
        with_header(axes=[{"name": 5, "boundary": "natural", "basis": "auto", "form": "cardinal"}]),
        with_header(nodes={"kind": "other"}),
        with_header(nodes=HUGE),
        with_header(version=99),
    ],
)
def test_forged_models_with_a_valid_checksum(tmp_path: Path, forge, rng: np.random.Generator) -> None:
    path = ShapeModel.fit(KNOTS[:1], generators(KNOTS[:1], LATTICE, rng), LATTICE).save(tmp_path / "model.npz")
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    forge(members)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.comment = b"sha256:" + b"0" * 64
        for name, content in members.items():
            archive.writestr(name, content)
    body = buffer.getvalue()[:-64]
    path.write_bytes(body + hashlib.sha256(body).hexdigest().encode())
    with pytest.raises(ModelFileError, match=r"model\.npz"):
        ShapeModel.load(path)


@pytest.mark.parametrize(("options", "reason"), [({"compression": zipfile.ZIP_DEFLATED}, "compressed"), ({}, "twice")])
@pytest.mark.filterwarnings("ignore:Duplicate name:UserWarning")
def test_archives_that_save_does_not_write(tmp_path: Path, options, reason, rng: np.random.Generator) -> None:
    path = ShapeModel.fit(KNOTS[:1], generators(KNOTS[:1], LATTICE, rng), LATTICE).save(tmp_path / "model.npz")
    with zipfile.ZipFile(path) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", **options) as archive:
        archive.comment = b"sha256:" + b"0" * 64
        for name, content in members if options else [*members, members[0]]:
            archive.writestr(name, content)
    body = buffer.getvalue()[:-64]
    path.write_bytes(body + hashlib.sha256(body).hexdigest().encode())
    with pytest.raises(ModelFileError, match=reason):
        ShapeModel.load(path)


def test_saving_into_a_folder_that_is_not_there(tmp_path: Path, rng: np.random.Generator) -> None:
    model = ShapeModel.fit(KNOTS[:1], generators(KNOTS[:1], LATTICE, rng), LATTICE)
    with pytest.raises(MissingFileError, match="folder that does not exist"):
        model.save(tmp_path / "a" / "model.npz")


def fit(knots=KNOTS[:1], u=None, nodes=LATTICE, **options):
    good = np.ones((4, *LATTICE.shape), dtype=np.complex64)
    return ShapeModel.fit(knots, good if u is None else u, nodes, **options)


BAD = np.ones((4, *LATTICE.shape), dtype=np.complex64)
BAD[2, 0, 1] = np.inf
KITE = asg.bodies.kite(0.5, 0.5)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: fit(u=np.ones((4, *LATTICE.shape))), DtypeError, "u: has dtype float64"),
        (lambda: fit(u=np.ones((3, *LATTICE.shape), complex)), ShapeError, "u: has shape"),
        (lambda: fit(u=BAD), NonFiniteError, r"u: is .* at index \(2, 0, 1\)"),
        (lambda: fit(knots=[[1, 2, 2, 3]]), KnotError, "knots"),
        (lambda: fit(knots=[[1, 3, 2, 4]]), KnotError, "knots"),
        (lambda: fit(knots=[[1]], u=np.ones((1, *LATTICE.shape), complex)), KnotError, "knots"),
        (lambda: fit(knots=np.arange(4.0)), ShapeError, "knots: is one ndarray"),
        (lambda: fit(knots=[]), ShapeError, "knots"),
        (lambda: fit(knots=[[0, 1, 2, 9]], basis="uniform"), KnotError, "equidistant"),
        (lambda: fit(boundary="periodic"), ArgumentError, "boundary: is 'periodic'"),
        (lambda: fit(basis="bezier"), ArgumentError, "basis: is 'bezier'"),
        (lambda: fit(names=["a", "b"]), ShapeError, "names: has 2 entries"),
        (lambda: fit(names=[5]), ArgumentError, r"names\[0\]: is 5"),
        (lambda: fit(names=5), DtypeError, "names: is a int"),
        (lambda: fit(knots=5), DtypeError, "knots: is a int"),
        (lambda: fit(knots=[[0, 1, 1 + 1e-9, 2]]), KnotError, "nearly equal, at index 1"),
        (lambda: fit(u=np.ma.masked_array(BAD, mask=True)), ArgumentError, "u: has masked entries"),
        (lambda: fit(nodes=3), DtypeError, "nodes: is a int"),
        (lambda: fit(backend="metal"), BackendError, "'metal' is not registered"),
        (lambda: fit(names=["height"]).predict([[1.2], [2.7]]), QueryRangeError, r"height.*2\.7"),
        (lambda: fit().predict([[np.nan]]), NonFiniteError, "lambdas: is nan"),
        (lambda: fit().predict([[1.2, 1.3]]), ShapeError, "lambdas: has shape"),
        (lambda: fit().predict(np.ones((0, 1))), ShapeError, "lambdas: has shape"),
        (lambda: fit().predict([["a"]]), DtypeError, "lambdas: has dtype"),
        (lambda: fit().predict([[1.2]], extrapolate="cubic"), ArgumentError, "extrapolate"),
        (lambda: fit().predict([[1.2]], derivative=1), ArgumentError, "derivative"),
        (lambda: fit().generate([[1.2]], Grid(Box((1, 1, 1)), 3)), ShapeError, "grid: is 3-D"),
        (lambda: fit().generate([[1.2]], "grid"), DtypeError, "grid: is a str"),
        (lambda: fit().generate([[1.2], [9.0]], Grid(Box((1, 1)), 3), batch=1), QueryRangeError, "9"),
        (lambda: ShapeModel.fit_bodies([[1, 2]], [KITE], LATTICE), ArgumentError, "bodies"),
        (
            lambda: ShapeModel.fit_bodies([[1, 2]], [KITE] * 3, FourierLattice(Box((7, 7)), 2)),
            ShapeError,
            "more than 2",
        ),
        (lambda: ShapeModel.fit_bodies([[1, 2]], [KITE], FourierLattice(Box((7, 7)), 2)), ShapeError, "bodies: has 1"),
        (lambda: ShapeModel.from_table([1.0, 2.0], [KITE] * 2, LATTICE), ShapeError, "lambdas: has shape"),
        (
            lambda: ShapeModel.from_table(np.random.default_rng(0).normal(size=(9, 3)), [KITE] * 9, LATTICE),
            TableError,
            "9 × 9 × 9",
        ),
    ],
)
def test_bad_input(call, error, message) -> None:
    with pytest.raises(error, match=message):
        call()


def test_a_training_body_without_a_cell_is_refused() -> None:
    """Millimetres taken for metres: the box is a thousand times too large, and no cell centre is in the body."""
    lattice = FourierLattice(Box((1600.0,) * 3), 2)
    empty = asg.voxelize(asg.bodies.ball(0.4), Grid(lattice.box, 20))
    with pytest.raises(ArgumentError, match=r"bodies\[0\]: is empty.*metres"):
        ShapeModel.fit_bodies([[0, 1]], [empty, empty], lattice)


def test_a_model_is_not_saved_over_a_folder(tmp_path: Path, rng: np.random.Generator) -> None:
    model = ShapeModel.fit(KNOTS[:1], generators(KNOTS[:1], LATTICE, rng), LATTICE)
    with pytest.raises(ModelFileError, match="is there and is not a file"):
        model.save(tmp_path)
