"""A picture of a file of `bearings export`, by the `vtk` package without a window: python paraview.py run.vtkhdf a.png

The slipping contacts, coloured by the logarithm of their power, between spheres coloured by the size of their spin.
"""

import sys
from pathlib import Path

import vtk


def read(path):
    """The spheres as points and the contacts as lines, at the last time."""
    if not Path(path).is_file():
        sys.exit(f"there is no file {path}; `bearings export RUN` writes it")
    reader = vtk.vtkHDFReader()
    reader.SetFileName(path)
    reader.Update()
    reader.SetStep(reader.GetNumberOfSteps() - 1)
    reader.Update()
    return reader.GetOutput()


def computed(data, name, formula, arrays, of_cells):
    """The data with one more array."""
    calculator = vtk.vtkArrayCalculator()
    calculator.SetInputData(data)
    calculator.SetAttributeTypeToCellData() if of_cells else calculator.SetAttributeTypeToPointData()
    for array, parts in arrays.items():
        calculator.AddScalarArrayName(array) if parts == 1 else calculator.AddVectorArrayName(array)
    calculator.SetFunction(formula)
    calculator.SetResultArrayName(name)
    calculator.Update()
    return calculator.GetOutput()


def colours(low, high, name):
    """A map of colours and its bar."""
    steps = {"spin speed": [(0.23, 0.30, 0.75), (0.87, 0.87, 0.87), (0.71, 0.02, 0.15)]}
    table, bar = vtk.vtkColorTransferFunction(), vtk.vtkScalarBarActor()
    for part, colour in enumerate(steps.get(name, [(0.99, 0.75, 0.15), (0.80, 0.28, 0.47), (0.05, 0.03, 0.53)])):
        table.AddRGBPoint(low + (high - low) * part / 2, *colour)
    bar.SetLookupTable(table)
    bar.SetTitle(name)
    bar.SetNumberOfLabels(3)
    bar.SetUnconstrainedFontSize(True)
    for text in (bar.GetTitleTextProperty(), bar.GetLabelTextProperty()):
        text.SetColor(0, 0, 0)
        text.ShadowOff()
        text.ItalicOff()
        text.BoldOff()
        text.SetFontSize(15)
    return table, bar


def picture(data):
    """What is seen of it, in a window that nobody sees."""
    scene, window = vtk.vtkRenderer(), vtk.vtkRenderWindow()
    window.SetOffScreenRendering(True)
    window.SetMultiSamples(8)
    window.SetSize(900, 700)
    legend = vtk.vtkRenderer()
    for part, area in ((scene, (0, 0, 0.86, 1)), (legend, (0.86, 0, 1, 1))):
        part.SetBackground(1, 1, 1)
        part.SetViewport(*area)
        window.AddRenderer(part)

    ball = vtk.vtkSphereSource()
    ball.SetRadius(0.16)
    ball.SetThetaResolution(24)
    ball.SetPhiResolution(16)
    spheres = vtk.vtkGlyph3D()
    spheres.SetSourceConnection(ball.GetOutputPort())
    spheres.SetInputData(computed(data, "spin speed", "mag(spin)", {"spin": 3}, of_cells=False))
    spheres.ScalingOff()

    slipping = vtk.vtkThreshold()
    slipping.SetInputData(computed(data, "log10 power", "log10(max(power, 1e-300))", {"power": 1}, of_cells=True))
    slipping.SetInputArrayToProcess(0, 0, 0, vtk.vtkDataObject.FIELD_ASSOCIATION_CELLS, "state")
    slipping.SetLowerThreshold(1)
    slipping.SetUpperThreshold(1)
    lines, rods = vtk.vtkGeometryFilter(), vtk.vtkTubeFilter()
    lines.SetInputConnection(slipping.GetOutputPort())
    rods.SetInputConnection(lines.GetOutputPort())
    rods.SetRadius(0.07)
    rods.SetNumberOfSides(12)

    for place, (shape, name) in enumerate(((spheres, "spin speed"), (rods, "log10 power"))):
        mapper, actor = vtk.vtkPolyDataMapper(), vtk.vtkActor()
        shape.Update()
        found = shape.GetOutput().GetCellData() if shape is rods else shape.GetOutput().GetPointData()
        table, bar = colours(*found.GetArray(name).GetRange(), name)
        mapper.SetInputConnection(shape.GetOutputPort())
        mapper.SetLookupTable(table)
        mapper.SetScalarModeToUseCellFieldData() if shape is rods else mapper.SetScalarModeToUsePointFieldData()
        mapper.SelectColorArray(name)
        actor.SetMapper(mapper)
        bar.SetPosition(0.05, 0.08 + 0.45 * place)
        bar.SetWidth(0.9)
        bar.SetHeight(0.38)
        scene.AddActor(actor)
        legend.AddViewProp(bar)
    scene.GetActiveCamera().SetPosition(1.0, -1.35, 0.75)
    scene.GetActiveCamera().SetViewUp(0, 0, 1)
    scene.ResetCamera()
    scene.GetActiveCamera().Zoom(1.12)
    window.Render()
    return window


if __name__ == "__main__":
    image, writer = vtk.vtkWindowToImageFilter(), vtk.vtkPNGWriter()
    image.SetInput(picture(read(sys.argv[1])))
    writer.SetInputConnection(image.GetOutputPort())
    writer.SetFileName(sys.argv[2])
    writer.Write()
