"""The pictures of a run, made from hand-made result files on a machine without a display.

What carries the weight: points fall where the camera's arithmetic says, the drawn depth is the stated factor
times the record's, a depth has one colour at all times, and no two texts of any picture overlap or leave it.
"""

import itertools
import os
import types
from dataclasses import fields, replace

import numpy as np
import pytest
from fretflow.case.config import Output
from fretflow.contact.law import ContactState
from fretflow.core.errors import InputError, StoreError
from fretflow.core.specimen_mesh import MeshGeometry, MeshSummary
from fretflow.core.store import write_record
from fretflow.pipeline.run_records import ForcedResponse
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.structure.reduction.reduced_specimen import ModeShapes, ReducedSpecimen
from fretflow.structure.two_mass_rig.lumped import RigModes
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.history import WearHistory, WearStep
from fretflow_post import faces, period, style
from fretflow_post.offscreen import require_offscreen
from fretflow_post.render import render_run, shown_rows
from matplotlib.collections import PolyCollection
from matplotlib.image import imread
from matplotlib.text import Text
from PIL import Image

pytestmark = pytest.mark.render

SIDE = 1e-3
CYCLES = np.array([0, 60_000, 190_000, 700_000, 1_900_000])


@pytest.fixture(scope="module", autouse=True)
def _offscreen():
    os.environ.pop("DISPLAY", None)
    require_offscreen()


@pytest.fixture
def figures(monkeypatch):
    """Keep every figure that is saved, by file name; all are drawn in this process, where they are seen."""
    kept = {}
    save = style.save_figure

    def keep(figure, path):
        kept[path.name] = figure
        return save(figure, path)

    monkeypatch.setattr(style, "save_figure", keep)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    return kept


def contact(elements=10):
    line = np.linspace(-0.5 * SIDE, 0.5 * SIDE, elements + 1)
    weight = np.convolve(np.diff(line), [0.5, 0.5])
    return np.array([(x, y) for x in line for y in line]), np.outer(weight, weight).ravel()


def worn_history(nodes, areas, upper_share=0.3, deepest=4e-6):
    corners = (2.0 * np.abs(nodes) / SIDE).prod(axis=1) ** 2
    share = CYCLES / CYCLES[-1]
    depth = deepest * np.outer(share, 0.5 + 0.5 * corners)
    return WearHistory(
        cycles=CYCLES, depth=depth, rate=np.tile(depth[-1] / CYCLES[-1], (5, 1)), volume=depth @ areas,
        dissipated_energy=np.full(5, 2e-3), sliding_distance=np.full(5, 1.1e-5), upper_share=upper_share,
        energy=2e-3 * CYCLES, approach=depth @ areas / areas.sum(), solves=5, stopped_by="cycles")


def steady_period(nodes, areas, swing=6e-6):
    tau = 2.0 * np.pi * np.arange(64) / 64
    radius = 2.0 * np.abs(nodes).max(axis=1) / SIDE
    pressure = 0.5 + radius**4
    force = np.zeros((64, len(nodes), 3))
    force[:, :, 2] = 60.0 * pressure * areas / (pressure @ areas)
    force[:, :, 0] = 0.8 * np.sin(tau)[:, None] * force[:, :, 2]
    motion = np.zeros_like(force)
    motion[:, :, 0] = swing * np.sin(tau - 0.4)[:, None]
    state = np.where(np.abs(np.sin(tau))[:, None] > 1.1 - radius, ContactState.SLIP, ContactState.STICK)
    state[:6, radius > 0.95] = ContactState.SEPARATION
    seen = np.column_stack([1.3 * swing * np.sin(tau - 0.4), np.zeros((64, 2))])
    return PeriodicSolution(
        method="test", frequency=100.0, displacement=motion, force=force, state=state.astype(np.int8),
        internal=np.zeros((64, 2)), outputs={"upper": seen, "lower": np.zeros((64, 3))},
        friction_force=force[:, :, 0].sum(axis=1), residual_history=(0.0,), error_estimate=0.0)


def ridge_mesh(upper):
    """Return a body of 6 x 6 x 2 mm with a ridge 1 mm wide, along x on the upper specimen, y on the lower."""
    across = np.r_[np.linspace(-3.0, -0.5, 3)[:-1], np.linspace(-0.5, 0.5, 11), np.linspace(0.5, 3.0, 3)[1:]]
    z = np.array([0.0, 0.5, 1.0, 2.0, 3.0])
    n = len(across)
    grid = np.stack(np.meshgrid(across, across, z, indexing="ij"), axis=-1).reshape(-1, 3) * SIDE
    number = np.arange(len(grid)).reshape(n, n, len(z))
    square = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    cells = np.stack([c[..., :-1] for c in square] + [c[..., 1:] for c in square], axis=-1)
    middle = 0.5 * (across[1:] + across[:-1])
    ridge = np.abs(middle) < 0.5
    keep = np.ones(cells.shape[:3], dtype=bool)
    keep[:, :, :2] = (ridge[None, :, None] if upper else ridge[:, None, None])
    cells = cells[keep]
    points = grid if upper else grid * [1.0, 1.0, -1.0]
    if not upper:
        cells = cells[:, [4, 5, 6, 7, 0, 1, 2, 3]]
    nodes = np.column_stack([contact()[0], np.zeros(121)])
    sign = 1.0 if upper else -1.0
    summary = MeshSummary(
        file="upper.msh", degree=1, cells=len(cells), nodes=len(points), contact_nodes=nodes,
        profile=np.zeros(121), observation_point=np.array([0.0, 0.0, sign * SIDE]), min_scaled_jacobian=1.0,
        min_jacobian=1e-12)
    return MeshGeometry(points=points, hexahedra=cells), summary


def reduced(nodes, areas):
    full = np.linspace(1.1e5, 8.3e5, 10)
    return ReducedSpecimen(
        stiffness=np.eye(382), mass=np.eye(382), contact_nodes=np.column_stack([nodes, np.zeros(121)]),
        contact_areas=areas, profile=np.zeros(121), observation_point=np.zeros(3),
        fixed_interface_frequencies=full, full_frequencies=full,
        reduced_frequencies=full * (1.0 + np.geomspace(1e-9, 6e-4, 10)), rayleigh_mass=0.0,
        rayleigh_stiffness=0.0, full_dofs=20655)


def beam_modes(points):
    """Return shapes that grow from the back: sliding along x, along y, and stretching, in another order of points."""
    rise = 1.0 - np.abs(points[:, 2]) / np.abs(points[:, 2]).max()
    shape = 3.0 * np.stack([rise[:, None] * np.eye(3)[axis] for axis in range(3)])
    return ModeShapes(frequency=np.array([1e5, 1.1e5, 2e5]), points=points[::-1], shape=shape[:, ::-1])


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Write the result files of a run and return the folder of each stage."""
    home = tmp_path_factory.mktemp("run")
    places = {name: home / name for name in ("mesh", "reduce", "solve", "wear", "response")}
    (places["wear"] / "checkpoints").mkdir(parents=True)
    for place in places.values():
        place.mkdir(exist_ok=True)
    nodes, areas = contact()
    history = worn_history(nodes, areas)
    for side in ("upper", "lower"):
        geometry, summary = ridge_mesh(side == "upper")
        write_record(places["mesh"] / f"{side}_geometry.h5", geometry)
        write_record(places["mesh"] / f"{side}.h5", summary)
        write_record(places["reduce"] / f"{side}.h5", reduced(nodes, areas))
        write_record(places["reduce"] / f"{side}_modes.h5", beam_modes(geometry.points))
    write_record(places["solve"] / "solution.h5", steady_period(nodes, areas))
    pair, both = np.array([40.0, 2500.0]), np.array([[1.0, 1.0], [-0.05, 1.0]])
    write_record(places["solve"] / "rig_modes.h5", RigModes(
        apart_frequency=pair, apart_shape=both, stuck_frequency=2.0 * pair, stuck_shape=both))
    write_record(places["wear"] / "history.h5", history)
    response = CycleResponse(**{f.name: areas if f.metadata["shape"] else 1.0 for f in fields(CycleResponse)})
    for row in (0, 2, 4):
        period = steady_period(nodes, areas, swing=6e-6 + row * 1e-6)
        step = WearStep(slow=history.slow(row), rate=history.rate[row],
                        response=response, proposed_jump=float("nan"), shortened=False, solves=row)
        write_record(places["wear"] / "checkpoints" / f"jump-{row:05d}.h5", step)
        write_record(places["wear"] / "checkpoints" / f"state-{row:05d}.h5", period)
    frequency = np.geomspace(20.0, 400.0, 40)
    for name, cycles, peak in (("unworn", 0, 71.0), ("worn", 1_900_000, 71.4)):
        motion = 1e-6 / (1.0 - (frequency / peak) ** 2 + 0.1j)
        write_record(places["response"] / f"{name}.h5", ForcedResponse(
            cycles=cycles, excitation=53.0, frequency=frequency, amplitude=np.abs(motion),
            phase=np.mod(-np.angle(motion), 2.0 * np.pi)))
    return places


def test_points_fall_where_the_view_says():
    from fretflow_post.scene import OVERSAMPLING, Layer, View, shoot, surface

    view = View(np.array([[0.0, 0.0, 0.0], [4.0, 3.0, 2.0]]), (0.6, -1.6, 1.0), (0.0, 0.0, 1.0), (400, 300))
    toward, right = view.axes[2], view.axes[0]
    for spot in np.array([[0.0, 0.0, 0.0], [4.0, 3.0, 2.0], [4.0, 0.0, 1.0]]):
        corners = spot + 0.1 * np.array([-right, np.cross(right, toward), right, np.cross(toward, right)])
        square = surface(corners, np.array([[0, 1, 2, 3]]))
        image = shoot([Layer(square, {"color": "red", "lighting": False})], view)
        rows, columns = np.nonzero(image[..., 1] < 128)
        seen = (np.array([columns.mean(), rows.mean()]) + 0.5) / OVERSAMPLING
        assert seen == pytest.approx(view.pixels(spot)[0], abs=0.7)


def test_the_drawn_depth_is_the_stated_factor_times_the_records(tmp_path, figures, monkeypatch):
    nodes, areas = contact()
    history = worn_history(nodes, areas, upper_share=0.3)
    scale = faces.wear_scale(nodes, np.zeros((2, 121)), history, [4])
    drawn = []
    shoot = faces.shoot

    def note(layers, view):
        drawn.append(layers[0].mesh)
        return shoot(layers, view)

    monkeypatch.setattr(faces, "shoot", note)
    faces.plot_wear(tmp_path / "wear.png", nodes, np.zeros((2, 121)), history, [4], scale)
    upper, lower = drawn
    words = " ".join(text.get_text() for text in figures["wear.png"].findobj(Text))
    factor = float(words.partition("exaggerated ")[2].partition(" times")[0].replace(",", ""))
    assert factor in (10.0, 20.0, 50.0, 100.0, 200.0)
    for mesh, share in ((upper, 0.3), (lower, 0.7)):
        assert mesh.points[:, 2] == pytest.approx(-1e3 * factor * share * history.depth[4], rel=1e-6)
        assert mesh.point_data["depth"] == pytest.approx(1e6 * share * history.depth[4])
    assert upper.points[:, 1] == pytest.approx(-1e3 * nodes[:, 1])  # turned over about x
    assert lower.points[:, 1] == pytest.approx(1e3 * nodes[:, 1])
    assert "upper face takes 30 %" in words
    assert f"deepest {style.figures(2.8)} µm" in words
    ticks = [t for t in figures["wear.png"].axes[-1].get_yticks() if t <= scale.top]
    assert ticks[-1] == scale.top == 3.0


def test_colours_of_all_panels_are_read_on_the_one_colour_bar(tmp_path):
    nodes, areas = contact()
    depth = np.outer([0, 1, 2, 3, 4], np.full(121, 1e-6))
    flat = replace(worn_history(nodes, areas, upper_share=0.25), depth=depth)
    scale = faces.wear_scale(nodes, np.zeros((2, 121)), flat, [2, 4])
    assert scale.top == 3.0
    path = faces.plot_wear(tmp_path / "flat.png", nodes, np.zeros((2, 121)), flat, [2, 4], scale)
    seen, expected = [], []
    for line, total in zip(np.array_split(imread(path)[150:, :1390, :3], 2), (2.0, 4.0), strict=True):
        for panel, share in zip(np.array_split(line, 2, axis=1), (0.25, 0.75), strict=True):
            coloured = panel[np.ptp(panel, axis=2) > 0.15]  # neither text nor side walls
            seen.append(np.median(coloured, axis=0))
            expected.append(style.colour_map(style.DEPTH_MAP)(share * total / 3.0)[:3])
    light = np.sum(seen) / np.sum(expected)  # the faces are lit, and all alike
    assert 0.85 < light <= 1.0
    assert np.array(seen) == pytest.approx(light * np.array(expected), abs=0.02)


def test_one_depth_has_one_colour_at_all_times(tmp_path):
    nodes, areas = contact()
    history = worn_history(nodes, areas)
    scale = faces.wear_scale(nodes, np.zeros((2, 121)), history, [1, 2, 4])
    panels = []
    for name, rows in (("early.png", [2, 1]), ("late.png", [2, 4])):
        image = imread(faces.plot_wear(tmp_path / name, nodes, np.zeros((2, 121)), history, rows, scale))
        middle = image.shape[0] * 55 // 100  # between the two lines of panels
        panels.append((image[150:middle, :1390], image[middle:, :1390]))
    assert np.array_equal(panels[0][0], panels[1][0])
    assert not np.array_equal(panels[0][1], panels[1][1])


def test_every_picture_of_a_run_is_there_and_not_blank(folders, tmp_path, figures):
    wishes = Output(loop_cycles=(190_000,), wear_map_cycles=(60_000, 190_000, 700_000))
    files = render_run(folders, tmp_path, wishes)
    names = [path.name for path in files]
    pictures = names[:names.index("modes.csv")]
    assert pictures == [
        "specimens.png", "contact_closeup.png", "modes.png", "rig_modes.png", "mode_shapes.png", "pressure.png",
        "stick_slip_unworn.png", "stick_slip_worn.png", "loops.png", "wear_depth.png", "wear_shape.png",
        "wear_volume.png", "response.png"]
    assert {"modes.csv", "loops.csv", "wear_volume.csv", "response.csv", "wear.pvd", "period.pvd",
            "period.gif"} <= set(names)
    assert {"upper_specimen.vtu", "lower_specimen.vtu"} <= set(names)
    assert all(path.stat().st_size > 0 for path in files)
    for path in files[:len(pictures)]:
        image = imread(path)
        assert image.shape[1] == 1600
        assert image.shape[0] >= 600
        assert np.mean(image[..., :3].min(axis=2) < 0.95) > 0.01
        assert len(np.unique((255 * image[::7, ::7, :3]).astype(int).reshape(-1, 3), axis=0)) > 20
    assert set(figures) == set(pictures)
    for name, figure in figures.items():
        assert_texts_clear(name, figure)


def assert_texts_clear(name, figure):
    """Check that level and upright texts lie in the picture and do not overlap."""
    boxes = [(text.get_text(), text.get_window_extent()) for text in drawn_texts(figure)
             if text.get_text().strip() and text.get_visible() and text.get_rotation() % 90.0 == 0.0]
    assert len(boxes) > 5
    for words, box in boxes:
        assert min(box.x0, box.y0) >= 0.0, (name, words)
        assert box.x1 <= figure.bbox.x1, (name, words)
        assert box.y1 <= figure.bbox.y1, (name, words)
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        assert not a.overlaps(b), f"{name}: {one!r} overlaps {other!r}"


def drawn_texts(figure):
    """Return the texts of `figure` without the tick labels beyond an axis's ends, which are not drawn."""
    yield from figure.texts
    for legend in figure.legends:
        yield from legend.get_texts()
    for axes in figure.axes:
        yield from (axes.title, *axes.texts)
        if axes.get_legend():
            yield from axes.get_legend().get_texts()
        if not axes.axison:
            continue
        yield from (axes.xaxis.label, axes.yaxis.label)
        for axis, place, limits in ((axes.xaxis, 0, axes.get_xlim()), (axes.yaxis, 1, axes.get_ylim())):
            low, high = sorted(limits)
            yield from (label for label in axis.get_ticklabels(which="both")
                        if low <= label.get_position()[place] <= high)


def test_an_unfinished_run_gives_what_it_has(folders, tmp_path):
    files = render_run({name: folders[name] for name in ("reduce", "solve")}, tmp_path)
    assert [path.name for path in files] == [
        "modes.png", "rig_modes.png", "pressure.png", "stick_slip_unworn.png", "loops.png", "modes.csv", "loops.csv",
        "period.gif"]


def test_pictures_and_formats_are_those_asked_for(folders, tmp_path):
    files = render_run(folders, tmp_path, Output(figures=("loops", "wear_volume"), figure_formats=("svg", "pdf")))
    assert [path.name for path in files] == ["loops.svg", "wear_volume.svg", "loops.pdf", "wear_volume.pdf",
                                             "loops.csv", "wear_volume.csv"]
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in files}
    begins = {"svg": b"<?xml", "pdf": b"%PDF", "csv": b"cycles"}
    assert all(path.read_bytes().startswith(begins[path.suffix[1:]]) for path in files)
    for wishes, words in (({"figures": ("loop",)}, r"figures: 'loop' is none of specimens, .*; did you mean loops\?"),
                          ({"figure_formats": ("jpg",)}, "figure_formats: 'jpg' is none of png, svg, pdf")):
        with pytest.raises(InputError, match=words):
            render_run(folders, tmp_path, Output().model_copy(update=wishes))


def test_a_period_moves_by_its_own_tractions(folders, tmp_path, monkeypatch):
    """What is drawn of the tractions, over the nodes' areas, is the force where the dot stands on the loop."""
    frames, shots = {}, period._shots

    def kept(figure, moving, show, moments):
        frames.update(moving=moving, show=show, moments=moments)
        return shots(figure, moving, show, moments)

    monkeypatch.setattr(period, "_shots", kept)
    nodes, areas = contact()
    solution = steady_period(nodes, areas)
    solution = replace(solution, friction_force=-solution.friction_force)  # of the upper specimen on the lower one
    path = period.plot_period(tmp_path / "period.png", nodes, areas, solution, "unworn")
    with Image.open(path) as drawn:
        assert drawn.n_frames == len(frames["moments"]) == 24
    assert path.stat().st_size < 1_000_000
    frames["show"](frames["moments"][5])
    tractions, states = (one for one in frames["moving"] if isinstance(one, PolyCollection))
    dot = frames["moving"][-1]
    shapes = [one.vertices[:4] for one in tractions.get_paths()]
    sizes = [0.5 * abs(np.sum(x * np.roll(y, 1) - y * np.roll(x, 1))) for x, y in (shape.T for shape in shapes)]
    assert np.sum(tractions.get_array() * sizes) == pytest.approx(dot.get_ydata()[0], rel=1e-9)
    assert set(np.unique(states.get_array())) <= {0.0, 1.0, 2.0}


def test_what_wear_changes_of_the_response_is_drawn(folders, tmp_path, figures):
    render_run({"response": folders["response"]}, tmp_path)
    change = next(axes for axes in figures["response.png"].axes if "unworn" in axes.get_ylabel())
    f, drawn = change.lines[-1].get_data()
    worn, new = (1.0 / np.abs(1.0 - (f / peak) ** 2 + 0.1j) / 53.0 for peak in (71.4, 71.0))
    assert len(f) == 40
    assert drawn == pytest.approx(worn - new, abs=1e-9)


@pytest.mark.fem  # the record lives beside PETSc
def test_the_static_pressure_is_shown_first_on_the_common_scale(folders, tmp_path, figures):
    from fretflow.structure.fem.preload import Preload

    _, areas = contact()
    pressure = np.linspace(10e6, 390e6, 121)
    write_record(tmp_path / "preload.h5", Preload(
        force=pressure * areas, pressure=pressure, gap=np.zeros(121), approach=1e-6))
    stages = {name: folders[name] for name in ("reduce", "solve", "wear")}
    render_run({**stages, "preload": tmp_path}, tmp_path)
    first, *others, bar = figures["pressure.png"].axes
    assert first.get_title().startswith("After the static load\ntotal 200 N\nmean 200, largest 390 MPa")
    assert len(others) == 3
    assert bar.get_ylim() == (0.0, 400.0)
    assert list(bar.get_yticks()) == [0.0, 5.0, 20.0, 50.0, 100.0, 200.0, 400.0]
    assert_texts_clear("pressure.png", figures["pressure.png"])


def test_a_damaged_result_is_named(folders, tmp_path):
    broken = tmp_path / "reduce"
    broken.mkdir()
    (broken / "upper.h5").write_bytes((folders["reduce"] / "upper.h5").read_bytes()[:2000])
    with pytest.raises(StoreError, match=r"reduce/upper\.h5"):
        render_run({"reduce": broken}, tmp_path)


@pytest.mark.parametrize(("asked", "rows"), [
    ((), [2, 4]), ((190_000,), [2, 4]), ((60_000, 1_900_000), [1, 4]), ((5_000_000,), [2, 4]),
    ((0, 700_000), [3, 4])])
def test_shown_rows_are_those_asked_for_and_the_end(asked, rows):
    assert shown_rows(types.SimpleNamespace(cycles=CYCLES), asked) == rows
