"""`bearings export`, read back by VTK's own reader, and its layout as plain HDF5 where that is not installed."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from taichi_bearings.export.vtkhdf import export
from taichi_bearings.runs.points_and_lines import points_and_lines
from taichi_bearings.runs.run_file import read_run

ROOT = Path(__file__).parents[2]
NO_VTK = "the package vtk, which reads the files back, is not installed; some systems have no wheel of it"


@pytest.fixture(scope="module")
def read():
    """A function (path, step) -> points, lines, point data and cell data as VTK has them, time, number of steps."""
    module = pytest.importorskip("vtkmodules.vtkIOHDF", reason=NO_VTK)
    from vtkmodules.util.numpy_support import vtk_to_numpy

    def arrays(data):
        return {data.GetArrayName(n): vtk_to_numpy(data.GetArray(n)) for n in range(data.GetNumberOfArrays())}

    def read_step(path, step=0):
        reader = module.vtkHDFReader()
        reader.SetFileName(str(path))
        reader.UpdateInformation()
        reader.SetStep(step)
        reader.Update()
        found = reader.GetOutput()
        lines = vtk_to_numpy(found.GetLines().GetConnectivityArray()).reshape(-1, 2)
        data = arrays(found.GetPointData()), arrays(found.GetCellData())
        return vtk_to_numpy(found.GetPoints().GetData()), lines, *data, reader.GetTimeValue(), reader.GetNumberOfSteps()

    return read_step


def same(found, columns):
    assert set(found) == set(columns)
    for name, column in columns.items():
        assert np.array_equal(found[name], column.values), name


@pytest.mark.parametrize("name", ["minimum", "discs"])
def test_vtk_reads_what_we_know_of_each_sphere_and_contact(name, request, read, tmp_path):
    run = request.getfixturevalue(name)
    report = export(run, tmp_path / "a.vtkhdf", analyse=True)
    rows = points_and_lines(read_run(run), analyse=True)
    points, lines, spheres, contacts, _, steps = read(tmp_path / "a.vtkhdf")
    assert (report["points"], report["lines"], report["steps"]) == (len(points), len(lines), 1)
    assert steps <= 1
    assert np.array_equal(lines, rows.network.contact.T)
    same(spheres, rows.spheres)
    same(contacts, rows.contacts)
    assert np.linalg.norm(points[lines[:, 1]] - points[lines[:, 0]], axis=1) == pytest.approx(2 * 0.5)
    assert np.array_equal(
        points[:, : rows.answer.scene.lattice.dimension], np.argwhere(rows.answer.scene.lattice.is_driven >= 0)
    )


def test_contacts_across_periodic_sides_lead_to_images_beyond_the_last_spheres(periodic, read, tmp_path):
    report = export(periodic, tmp_path / "a.vtkhdf", analyse=True)
    rows = points_and_lines(read_run(periodic), analyse=True)
    lattice, sites = rows.answer.scene.lattice, rows.answer.scene.lattice.sites
    for step, moment in enumerate(rows.moments.spin):
        points, lines, spheres, contacts, *_ = read(tmp_path / "a.vtkhdf", step)
        assert report["points"] + report["images"] == len(points)
        assert report["lines"] == len(lines) == lattice.all_contacts
        assert np.array_equal(lines[:, 0], rows.network.contact.T[:, 0])
        assert np.array_equal(spheres["spin"][lines], moment[rows.network.contact.T])  # an image turns as its sphere
        assert np.array_equal(spheres["domain"][lines], rows.spheres["domain"].values[rows.network.contact.T])
        assert np.array_equal(contacts["slip"], rows.moments.slip[step])
    assert np.array_equal(points[lines[:, 1]] - points[lines[:, 0]], np.eye(3)[contacts["axis"]])
    layers = sites // np.array(lattice.shape)
    assert len(points) == sites + sum(layers[axis] for axis in lattice.periodic)
    assert np.array_equal(spheres["image"], np.arange(len(points)) >= sites)


def test_vtk_reads_the_snapshots_as_time_steps_and_the_answer_as_the_last(dynamics, read, tmp_path):
    path = tmp_path / "a.vtkhdf"
    rows = points_and_lines(read_run(dynamics), analyse=True)
    number = export(dynamics, path, analyse=True)["steps"]
    assert number == len(rows.moments.time) + 1 == 4
    for step, time in enumerate(rows.moments.time):
        points, lines, spheres, contacts, found, steps = read(path, step)
        assert (found, steps) == (time, number)
        assert (len(points), len(lines)) == (60, len(rows.network.contact.T))
        assert np.array_equal(spheres["spin"], rows.moments.spin[step])
        assert np.array_equal(spheres["domain"], rows.spheres["domain"].values)
        assert np.array_equal(contacts["slip"], rows.moments.slip[step])
        assert np.array_equal(contacts["state"], rows.moments.state[step])
        assert np.isnan(contacts["power"]).all()
        assert not contacts["proven"].any()
    *_, spheres, contacts, time, _ = read(path, number - 1)
    assert time == rows.time
    same(spheres, rows.spheres)
    same(contacts, rows.contacts)


def test_a_picture_is_drawn_of_it_without_a_window(minimum, tmp_path):
    pytest.importorskip("vtkmodules.vtkRenderingOpenGL2", reason=NO_VTK)
    export(minimum, tmp_path / "a.vtkhdf", analyse=True)
    words = [sys.executable, ROOT / "docs" / "paraview.py", tmp_path / "a.vtkhdf", tmp_path / "a.png"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    from matplotlib.image import imread

    pixels = imread(tmp_path / "a.png")[..., :3]
    assert pixels.shape == (700, 900, 3)
    red, green, blue = (pixels[:, :760, k] for k in range(3))
    assert (red - blue > 0.4).mean() > 0.005  # spheres of the top plane
    assert (blue - red > 0.2).mean() > 0.01  # those of the bottom, and strong contacts
    assert ((red > 0.98) & (green > 0.98) & (blue > 0.98)).mean() > 0.2  # the paper
