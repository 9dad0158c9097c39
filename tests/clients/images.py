"""Volumes, transforms and segmentations: what SimpleITK, nibabel and slicerio write is read here, and the transform by them."""

import numpy as np
from client import Row, client, folder, items, osteoflow, recorded

# A ball in LPS mm, as HU that fall by 50 a millimetre: at 0 HU its surface is RADIUS from CENTRE.
CENTRE = np.array([12.5, -40.25, 101.0])
RADIUS = 18.0
SIZE, SPACING = (48, 52, 44), np.array([1.0, 0.9, 1.1])
ORIGIN = CENTRE - SPACING * (np.array(SIZE) - 1) / 2 + 0.3
# Of a distance field that is interpolated linearly: a voxel squared over eight radii.
SAMPLED_MM = 0.03


def ball(direction):
    """The voxels, x fastest last, of a grid whose axes are the columns of `direction`, in LPS."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in SIZE), indexing="ij"), axis=-1)
    origin = CENTRE - direction @ (CENTRE - ORIGIN)
    places = origin + (index * SPACING) @ direction.T
    return (50 * (RADIUS - np.linalg.norm(places - CENTRE, axis=-1))).astype(np.float32), origin


def oblique():
    a, b = 0.3, -0.2
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return about_z @ about_x


def surface_off(volume, iso=0):
    """How far the surface that this program finds in a volume is from the ball's."""
    from clouds import ours

    out = folder() / f"surface-{volume.name.replace('.', '-')}.stl"
    out.unlink(missing_ok=True)
    osteoflow("convert", volume, out, "--iso-hu", iso)
    points = ours(out)
    assert len(points) > 1000, f"{len(points)} points"
    return float(np.abs(np.linalg.norm(points - CENTRE, axis=1) - RADIUS).max())


@client("SimpleITK", module="SimpleITK")
def simple_itk():
    import SimpleITK as sitk

    for name, direction in [("straight", np.eye(3)), ("oblique", oblique())]:
        voxels, origin = ball(direction)
        image = sitk.GetImageFromArray(voxels.transpose(2, 1, 0))
        image.SetOrigin(origin.tolist())
        image.SetSpacing(SPACING.tolist())
        image.SetDirection(direction.ravel().tolist())
        for ending in ["nrrd", "nhdr", "nii", "nii.gz", "mha", "mhd"]:
            path = folder() / f"sitk-{name}.{ending}"
            sitk.WriteImage(image, str(path), name == "oblique")
            yield Row(f"{ending}, {name}, written and its surface found here", surface_off(path), tolerance=SAMPLED_MM)
    series = folder() / "sitk-series"
    series.mkdir()
    voxels, origin = ball(np.eye(3))
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    image = sitk.Cast(sitk.GetImageFromArray(voxels.transpose(2, 1, 0)), sitk.sitkInt16)
    image.SetSpacing(SPACING.tolist())
    image.SetOrigin(origin.tolist())
    for k in range(SIZE[2]):
        layer = image[:, :, k]
        for key, value in {
            "0008|0060": "CT",
            "0020|000e": "1.2.826.0.1.3680043.2.1125.1",
            "0020|000d": "1.2.826.0.1.3680043.2.1125.2",
            "0020|0052": "1.2.826.0.1.3680043.2.1125.3",
            "0020|0032": "\\".join(map(str, image.TransformIndexToPhysicalPoint((0, 0, k)))),
            "0020|0037": "1\\0\\0\\0\\1\\0",
            "0020|0013": str(k),
            "0028|1052": "0",
            "0028|1053": "1",
        }.items():
            layer.SetMetaData(key, value)
        writer.SetFileName(str(series / f"{k}.dcm"))
        writer.Execute(layer)
    # Whole HU of 0.02 mm each.
    yield Row("DICOM series, written and its surface found here", surface_off(series), tolerance=SAMPLED_MM + 0.02)

    run = recorded()
    moves = sitk.ReadTransform(str(run / "export" / "scan_to_ct.tfm")).GetInverse()
    scan = items(run, "to_bone.cloud")[0].columns["points"][::40]
    x, y, z, qx, qy, qz, qw = items(run, "icp.t_target_source")[0].fields["isometry"]
    turn = sitk.VersorRigid3DTransform()
    turn.SetRotation([qx, qy, qz, qw])
    turn.SetTranslation([x, y, z])
    off = [np.subtract(moves.TransformPoint(p.tolist()), turn.TransformPoint(p.tolist())) for p in scan]
    yield Row("scan_to_ct.tfm read", float(np.abs(off).max()))


@client("nibabel", module="nibabel")
def of_nibabel():
    import nibabel

    # NIfTI is RAS.
    to_ras = np.diag([-1.0, -1.0, 1.0, 1.0])
    for name, direction in [("straight", np.eye(3)), ("oblique", oblique())]:
        voxels, origin = ball(direction)
        affine = np.eye(4)
        affine[:3, :3], affine[:3, 3] = direction * SPACING, origin
        for kind, ending in [(nibabel.Nifti1Image, "nii.gz"), (nibabel.Nifti2Image, "nii")]:
            path = folder() / f"nibabel-{name}.{ending}"
            nibabel.save(kind(voxels, to_ras @ affine), path)
            what = kind.__name__.removesuffix("Image").replace("Nifti", "NIfTI-")
            yield Row(f"{what}, {name}, written and its surface found here", surface_off(path), tolerance=SAMPLED_MM)
    for kind, ending, named in [(nibabel.MGHImage, "mgz", "MGZ of FreeSurfer"), (nibabel.MGHImage, "mgh", "MGH of FreeSurfer"), (nibabel.AnalyzeImage, "hdr", "ANALYZE 7.5")]:
        path = folder() / f"refused.{ending}"
        nibabel.save(kind(voxels, np.diag([1.0, 1, 1, 1])), path.with_suffix(".img") if ending == "hdr" else path)
        done = osteoflow("convert", path, folder() / "refused.stl", "--iso-hu", "0", check=False)
        assert done.returncode != 0 and named in done.stderr, done.stderr
        yield Row(f".{ending} refused by its name", 0.0, "")


@client("slicerio", module="slicerio")
def of_slicerio():
    import slicerio

    voxels, origin = ball(np.eye(3))
    path = folder() / "slicerio.seg.nrrd"
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = np.diag(SPACING), origin
    slicerio.write_segmentation(
        str(path),
        {
            "voxels": (voxels > 0).astype(np.uint8),
            "ijkToLPS": affine,
            "segments": [{"name": "bone", "labelValue": 1, "color": [0.9, 0.85, 0.75]}],
        },
    )
    # A mask has its surface half a voxel off at most.
    yield Row("segmentation (.seg.nrrd), written and its surface found here", surface_off(path, 0.5), tolerance=0.8)
