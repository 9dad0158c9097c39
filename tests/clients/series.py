"""CT series of DICOM as archives compress them: what pydicom and dcmtk write is read here."""

import shutil

import numpy as np
from client import Row, client, debian, folder, osteoflow, run
from images import ORIGIN, SAMPLED_MM, SIZE, SPACING, ball, oblique, surface_off

# Whole HU of 0.02 mm each.
TOLERANCE_MM = SAMPLED_MM + 0.02


def data_set(storage, number):
    """A data set of pydicom without place and pixels."""
    from pydicom.dataset import Dataset, FileMetaDataset
    from pydicom.uid import ExplicitVRLittleEndian

    d = Dataset()
    d.file_meta = FileMetaDataset()
    d.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    d.file_meta.MediaStorageSOPClassUID = d.SOPClassUID = storage
    d.file_meta.MediaStorageSOPInstanceUID = d.SOPInstanceUID = f"1.2.826.0.1.3680043.2.1125.8.{number}"
    d.Modality, d.SeriesInstanceUID, d.SeriesNumber = "CT", "1.2.826.0.1.3680043.2.1125.7", 7
    d.Rows, d.Columns, d.SamplesPerPixel, d.PhotometricInterpretation = SIZE[1], SIZE[0], 1, "MONOCHROME2"
    d.BitsAllocated, d.BitsStored, d.HighBit, d.PixelRepresentation = 16, 16, 15, 1
    return d


def written(name, change=None, direction=None):
    """A series of the ball, by pydicom."""
    from pydicom.uid import CTImageStorage

    out = folder() / name
    out.mkdir()
    direction = np.eye(3) if direction is None else direction
    voxels, origin = ball(direction)
    for k in range(SIZE[2]):
        d = data_set(CTImageStorage, k)
        d.PixelSpacing, d.SliceThickness = [SPACING[1], SPACING[0]], SPACING[2]
        d.ImagePositionPatient = [f"{c:.8f}" for c in origin + direction[:, 2] * SPACING[2] * k]
        d.ImageOrientationPatient = [f"{c:.12f}" for c in np.r_[direction[:, 0], direction[:, 1]]]
        d.RescaleIntercept, d.RescaleSlope = -1024 + k, 1
        stored = np.clip(np.rint(voxels[:, :, k].T) + 1024 - k, -32768, 32767)
        d.PixelData = stored.astype("<i2").tobytes()
        d["PixelData"].VR = "OW"
        if change:
            change(d)
        d.save_as(out / f"{k}.dcm", enforce_file_format=True)
    return out


def row(what, series):
    return Row(f"DICOM series, {what}, written and its surface found here", surface_off(series), tolerance=TOLERANCE_MM)


@client("pydicom", module="pydicom")
def of_pydicom():
    from pydicom.uid import EnhancedCTImageStorage, RLELossless

    yield row("oblique", written("pydicom-oblique", direction=oblique()))
    yield row("RLE", written("pydicom-rle", lambda d: d.compress(RLELossless)))
    from pydicom.dataset import Dataset

    voxels, origin = ball(np.eye(3))
    d = data_set(EnhancedCTImageStorage, 1)
    d.NumberOfFrames = SIZE[2]

    def group(**attributes):
        item = Dataset()
        for name, value in attributes.items():
            setattr(item, name, value)
        return [item]

    shared = Dataset()
    shared.PixelMeasuresSequence = group(PixelSpacing=[SPACING[1], SPACING[0]], SliceThickness=SPACING[2])
    shared.PlaneOrientationSequence = group(ImageOrientationPatient=[1, 0, 0, 0, 1, 0])
    shared.PixelValueTransformationSequence = group(RescaleIntercept=0, RescaleSlope=1, RescaleType="HU")
    d.SharedFunctionalGroupsSequence = [shared]
    d.PerFrameFunctionalGroupsSequence = []
    for k in reversed(range(SIZE[2])):
        frame = Dataset()
        frame.PlanePositionSequence = group(ImagePositionPatient=[f"{c:.8f}" for c in origin + [0, 0, SPACING[2] * k]])
        d.PerFrameFunctionalGroupsSequence.append(frame)
    d.PixelData = np.rint(voxels[:, :, ::-1]).astype("<i2").transpose(2, 1, 0).tobytes()
    d["PixelData"].VR = "OW"
    path = folder() / "enhanced.dcm"
    d.save_as(path, enforce_file_format=True)
    yield row("enhanced, in one file", path)


@client("OpenJPEG (pylibjpeg)", module="openjpeg", package="pylibjpeg-openjpeg")
def of_openjpeg():
    from pydicom.uid import JPEG2000Lossless

    yield row("JPEG 2000", written("openjpeg", lambda d: d.compress(JPEG2000Lossless)))


@client("dcmtk", version=lambda: debian("dcmtk"), module="pydicom", program="dcmcjpeg")
def of_dcmtk():
    plain = written("dcmtk-plain")
    for name, command in {
        "JPEG lossless": ["dcmcjpeg", "+e1"],
        "RLE": ["dcmcrle"],
        "deflated": ["dcmconv", "+td"],
        "big-endian": ["dcmconv", "+tb"],
        "without preamble": ["dcmconv", "-F"],
    }.items():
        out = folder() / f"dcmtk-{name}"
        out.mkdir()
        for file in plain.iterdir():
            run(*command, file, out / file.name)
        yield row(name, out)
    out = folder() / "dcmtk-jpeg-ls"
    out.mkdir()
    for file in plain.iterdir():
        run("dcmcjpls", file, out / file.name)
    done = osteoflow("convert", out, folder() / "none.stl", "--iso-hu", "0", check=False)
    command = done.stderr.split(": ")[-1].strip()
    assert done.returncode != 0 and command.startswith("mkdir RAW; for f in "), done.stderr
    raw = folder() / "RAW"
    shutil.rmtree(raw, ignore_errors=True)
    run("sh", "-c", command, cwd=folder())
    yield row("JPEG-LS by the command that its refusal names", raw)
