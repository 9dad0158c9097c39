"""CT series of DICOM as archives compress them: what pydicom and dcmtk write is read here."""

import shlex
import shutil
import sys

import numpy as np
from client import Missing, Row, client, debian, folder, osteoflow, run
from images import SAMPLED_MM, SIZE, SPACING, ball, oblique, surface_off

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
    from pydicom.encaps import encapsulate
    from pydicom.uid import UID, EnhancedCTImageStorage, RLELossless, SecondaryCaptureImageStorage

    encapsulated_uncompressed = UID("1.2.840.10008.1.2.1.98")

    yield row("oblique", written("pydicom-oblique", direction=oblique()))
    yield row("RLE", written("pydicom-rle", lambda d: d.compress(RLELossless)))

    def encapsulated(d):
        d.file_meta.TransferSyntaxUID = encapsulated_uncompressed
        d.PixelData = encapsulate([d.PixelData])
        d["PixelData"].VR = "OB"
        d["PixelData"].is_undefined_length = True

    yield row("uncompressed in fragments", written("pydicom-fragments", encapsulated))
    study = written("pydicom-study")
    page = data_set(SecondaryCaptureImageStorage, 999)
    page.SeriesInstanceUID, page.SeriesNumber, page.Rows, page.Columns = "1.2.826.0.1.3680043.2.1125.9", 401, 8, 8
    page.SamplesPerPixel, page.PhotometricInterpretation, page.PlanarConfiguration = 3, "RGB", 0
    page.BitsAllocated, page.BitsStored, page.HighBit, page.PixelRepresentation = 8, 8, 7, 0
    page.PixelData = bytes(8 * 8 * 3)
    page["PixelData"].VR = "OB"
    page.save_as(study / "page.dcm", enforce_file_format=True)
    yield row("beside a page in colours", study)
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
    twelve = written("dcmtk-twelve", of_12_bits)
    for name, source, command, tolerance in (
        ("JPEG-LS", plain, ["dcmcjpls"], TOLERANCE_MM),
        ("JPEG-LS near-lossless", twelve, ["dcmcjpls", "+en"], 2 * TOLERANCE_MM),
        # Two bits are cut off: up to 3 HU.
        ("JPEG lossless with a point transform", plain, ["dcmcjpeg", "+e1", "+pt", "2"], 0.15),
        # Of 12 bits; the errors of the compression at quality 100 are some HU of 0.02 mm each.
        ("JPEG of 12 bits, lossy", twelve, ["dcmcjpeg", "+ee", "+q", "100"], 0.3),
    ):
        out = folder() / f"dcmtk-{name}"
        out.mkdir()
        for file in source.iterdir():
            run(*command, file, out / file.name)
        yield converted(name, out, tolerance)


def of_12_bits(d):
    """Stores a layer of the ball as unsigned numbers of 12 bits."""
    values = np.frombuffer(d.PixelData, "<i2").astype(int) + int(d.RescaleIntercept)
    d.BitsStored, d.HighBit, d.PixelRepresentation, d.RescaleIntercept = 12, 11, 0, -2048
    d.PixelData = np.clip(values + 2048, 0, 4095).astype("<u2").tobytes()


def converted(name, series, tolerance=TOLERANCE_MM):
    """A series that is refused by its name, and read after the command that the refusal names."""
    done = osteoflow("convert", series, folder() / "none.stl", "--iso-hu", "0", check=False)
    command = done.stderr[done.stderr.find("mkdir RAW; ") :].strip()
    assert done.returncode != 0 and command.startswith("mkdir RAW; "), done.stderr
    raw = folder() / "RAW"
    shutil.rmtree(raw, ignore_errors=True)
    # Its Python is this one, which has the packages.
    run("sh", "-c", command.replace("python3", shlex.quote(sys.executable)), cwd=folder())
    what = f"DICOM series, {name} by the command that its refusal names, written and its surface found here"
    return Row(what, surface_off(raw), tolerance=tolerance)


@client("OpenJPH", version=lambda: debian("openjph-tools"), module="pydicom", program="ojph_compress")
def of_openjph():
    from pydicom.encaps import encapsulate
    from pydicom.uid import HTJ2K, HTJ2KLossless, HTJ2KLosslessRPCL

    try:
        import openjpeg  # noqa: F401 (pydicom decodes by it)
    except ImportError as error:
        raise Missing("no Python package pylibjpeg-openjpeg") from error
    for name, syntax, options, tolerance in (
        ("high-throughput JPEG 2000, lossless", HTJ2KLossless, ["-reversible", "true"], TOLERANCE_MM),
        ("high-throughput JPEG 2000, lossless, by resolution", HTJ2KLosslessRPCL, ["-reversible", "true", "-prog_order", "RPCL"], TOLERANCE_MM),
        ("high-throughput JPEG 2000, lossy", HTJ2K, ["-qstep", "0.0001"], 0.2),
    ):

        def compress(d, options=options, syntax=syntax):
            of_12_bits(d)
            picture, stream = folder() / "layer.pgm", folder() / "layer.j2c"
            cells = np.frombuffer(d.PixelData, "<u2").astype(">u2").tobytes()
            picture.write_bytes(b"P5\n%d %d\n4095\n" % (d.Columns, d.Rows) + cells)
            run("ojph_compress", "-i", picture, "-o", stream, *options)
            d.file_meta.TransferSyntaxUID = syntax
            d.PixelData = encapsulate([stream.read_bytes()])
            d["PixelData"].VR = "OB"
            d["PixelData"].is_undefined_length = True

        yield converted(name, written(f"openjph-{syntax}", compress), tolerance)
