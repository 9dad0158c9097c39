"""Writes the volumes beside it by other programs, and what these read in them as truth.json: python make.py

pydicom 3.0.2 with pylibjpeg-openjpeg 2.6.0, dcmtk 3.6.7 (dcmcjpeg, dcmcrle, dcmcjpls, dcmconv, dcmmkdir), OpenJPH 0.9.0 (ojph_compress),
SimpleITK 2.5.7, pynrrd 1.1.3.
"""

import hashlib
import json
import os
import shutil
import subprocess

import nrrd
import numpy as np
import pydicom
import SimpleITK as sitk
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.encaps import encapsulate, generate_frames
from pydicom.uid import (
    CTImageStorage,
    EnhancedCTImageStorage,
    HTJ2KLossless,
    ExplicitVRLittleEndian,
    JPEG2000Lossless,
    SecondaryCaptureImageStorage,
)

HERE = os.path.dirname(os.path.abspath(__file__))
NX, NY, NZ = 34, 33, 3
SPACING = (0.6, 0.7, 1.25)
FIRST = np.array([-50.5, 33.25, -400.125])
z, y, x = np.mgrid[:NZ, :NY, :NX]
r = np.sqrt((x - 15.2) ** 2 + (y - 13.7) ** 2 + (2 * z) ** 2)
CT = np.clip(1250 - 190 * np.maximum(r - 6, 0), -1000, 1250).astype(int) + (3 * x + 5 * y + 7 * z) % 4


def turned():
    a = np.deg2rad([20, -35, 50])
    (cx, cy, cz), (sx, sy, sz) = np.cos(a), np.sin(a)
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return rz @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])


R = turned()
n_uid = 0


def uid():
    global n_uid
    n_uid += 1
    return f"1.2.826.0.1.3680043.10.1337.{n_uid}"


STUDY = uid()


def layer(series, k, number=3, storage=CTImageStorage, rotation=R):
    d = Dataset()
    d.file_meta = FileMetaDataset()
    d.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    d.file_meta.MediaStorageSOPClassUID = d.SOPClassUID = storage
    d.file_meta.MediaStorageSOPInstanceUID = d.SOPInstanceUID = uid()
    d.PatientName, d.PatientID, d.Modality = "Doe^Jane", "4711", "CT"
    d.StudyID, d.StudyDate, d.StudyTime = "1", "20260101", "120000"
    d.StudyInstanceUID, d.SeriesInstanceUID, d.SeriesNumber, d.InstanceNumber = STUDY, series, number, k + 1
    d.Rows, d.Columns, d.PixelSpacing, d.SliceThickness = NY, NX, [SPACING[1], SPACING[0]], SPACING[2]
    place = FIRST + rotation[:, 2] * SPACING[2] * k
    d.ImagePositionPatient = [round(float(c), 8) for c in place]
    d.ImageOrientationPatient = [round(float(c), 10) for c in np.r_[rotation[:, 0], rotation[:, 1]]]
    d.SamplesPerPixel, d.PhotometricInterpretation = 1, "MONOCHROME2"
    d.BitsAllocated = d.BitsStored = 16
    d.HighBit, d.PixelRepresentation, d.RescaleIntercept, d.RescaleSlope = 15, 1, -5 * k, 1
    d.PixelData = (CT[k] + 5 * k).astype("<i2").tobytes()
    d["PixelData"].VR = "OW"
    return d


def jpeg_2000(d, fragments=1):
    d.compress(JPEG2000Lossless, generate_instance_uid=False)
    if fragments > 1:
        (frame,) = generate_frames(d.PixelData, number_of_frames=1)
        d.PixelData = encapsulate([frame], fragments_per_frame=fragments)
        d["PixelData"].is_undefined_length = True


def of_12_bits(d):
    """Stored as unsigned numbers of 12 bits."""
    values = np.frombuffer(d.PixelData, "<i2").astype(int)
    d.BitsStored, d.HighBit, d.PixelRepresentation, d.RescaleIntercept = 12, 11, 0, d.RescaleIntercept - 1100
    d.PixelData = (values + 1100).astype("<u2").tobytes()


def high_throughput(d):
    of_12_bits(d)
    picture, stream = path("layer.pgm"), path("layer.j2c")
    cells = np.frombuffer(d.PixelData, "<u2").astype(">u2").tobytes()
    open(picture, "wb").write(b"P5\n%d %d\n4095\n" % (NX, NY) + cells)
    subprocess.run(["ojph_compress", "-i", picture, "-o", stream, "-reversible", "true"], check=True, capture_output=True)
    d.file_meta.TransferSyntaxUID = HTJ2KLossless
    d.PixelData = encapsulate([open(stream, "rb").read()])
    d["PixelData"].VR = "OB"
    d["PixelData"].is_undefined_length = True
    os.remove(picture)
    os.remove(stream)


def path(*names):
    full = os.path.join(HERE, *names)
    os.makedirs(os.path.dirname(full), exist_ok=True)
    return full


def series(name, change=None, order=range(NZ), **more):
    of = uid()
    for i, k in enumerate(order):
        d = layer(of, k, **more)
        if change:
            change(d)
        d.save_as(path(name, f"I{i}"), enforce_file_format=True)


def converted(name, source, command):
    for file in sorted(os.listdir(path(source, ""))):
        subprocess.run([*command, path(source, file), path(name, file)], check=True, capture_output=True)


def enhanced(name):
    d = layer(uid(), 0, storage=EnhancedCTImageStorage)
    for key in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing", "SliceThickness", "RescaleIntercept", "RescaleSlope"):
        delattr(d, key)
    d.ImageType, d.NumberOfFrames = ["ORIGINAL", "PRIMARY", "VOLUME", "NONE"], NZ
    shared, measures, orientation = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing, measures.SliceThickness = [SPACING[1], SPACING[0]], SPACING[2]
    orientation.ImageOrientationPatient = [round(float(c), 10) for c in np.r_[R[:, 0], R[:, 1]]]
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = [measures], [orientation]
    d.SharedFunctionalGroupsSequence = [shared]
    frames = []
    for k in range(NZ):
        frame, position, values, content = Dataset(), Dataset(), Dataset(), Dataset()
        position.ImagePositionPatient = [round(float(c), 8) for c in FIRST + R[:, 2] * SPACING[2] * k]
        values.RescaleIntercept, values.RescaleSlope, values.RescaleType = -5 * k, 1, "HU"
        content.StackID, content.InStackPositionNumber = "1", k + 1
        frame.PlanePositionSequence, frame.PixelValueTransformationSequence = [position], [values]
        frame.FrameContentSequence = [content]
        frames.append(frame)
    d.PerFrameFunctionalGroupsSequence = frames
    d.PixelData = b"".join((CT[k] + 5 * k).astype("<i2").tobytes() for k in range(NZ))
    d["PixelData"].VR = "OW"
    jpeg_2000(d)
    d.save_as(path(name), enforce_file_format=True)


def page(d):
    """A page of text in colours, as a report of the dose."""
    d.Rows = d.Columns = 8
    d.ImageType = ["DERIVED", "SECONDARY", "DOSE_INFO"]
    d.SamplesPerPixel, d.PhotometricInterpretation, d.PlanarConfiguration = 3, "RGB", 0
    d.BitsAllocated = d.BitsStored = 8
    d.HighBit, d.PixelRepresentation, d.PixelData = 7, 0, bytes(8 * 8 * 3)


def screen(d):
    for key in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing"):
        delattr(d, key)
    small(d)


def small(d):
    d.Rows = d.Columns = 8
    d.PixelData = bytes(128)


def scout(d):
    d.ImageType = ["ORIGINAL", "PRIMARY", "LOCALIZER"]
    small(d)


for old in os.listdir(HERE):
    if old != "make.py":
        shutil.rmtree(path(old)) if os.path.isdir(path(old)) else os.remove(path(old))
series("plain")
series("jpeg_2000", jpeg_2000)
series("jpeg_2000_fragments", lambda d: jpeg_2000(d, 3))
converted("jpeg_lossless", "plain", ["dcmcjpeg", "+e1"])
converted("jpeg_lossless_predictor_6", "plain", ["dcmcjpeg", "+el", "+sv", "6"])
converted("jpeg_lossless_point", "plain", ["dcmcjpeg", "+e1", "+pt", "2"])
converted("jpeg_ls", "plain", ["dcmcjpls"])
series("jpeg_12_bits", of_12_bits, [0])
converted("jpeg_12_bits", "jpeg_12_bits", ["dcmcjpeg", "+ee"])
series("jpeg_2000_high_throughput", high_throughput, [0])
converted("rle", "plain", ["dcmcrle"])
converted("deflated", "plain", ["dcmconv", "+td"])
converted("big_endian", "plain", ["dcmconv", "+tb"])
converted("without_preamble", "plain", ["dcmconv", "+ti", "-F"])
enhanced("enhanced.dcm")
series("study", jpeg_2000, order=[2, 0, 1])
series("study/dose", page, [0], number=401)
series("study/scout", scout, [0, 1], number=1, rotation=np.eye(3)[:, [0, 2, 1]])
series("study/screen", screen, [0], number=999, storage=SecondaryCaptureImageStorage)
subprocess.run(["dcmmkdir", "+r", "+id", path("study"), "+D", path("study", "DICOMDIR"), "-W", "-Nxc"], capture_output=True)
open(path("study", ".DS_Store"), "wb").write(b"\0\0\0\1Bud1")

image = sitk.GetImageFromArray(CT.astype(np.int16))
image.SetSpacing(SPACING)
image.SetOrigin(FIRST)
image.SetDirection(R.ravel())
left = sitk.Image(image)
left.SetDirection((R @ np.diag([1, 1, -1])).ravel())
sitk.WriteImage(image, path("oblique.mha"))
sitk.WriteImage(left, path("left_handed.mha"), True)
sitk.WriteImage(image, path("detached.mhd"), True)
sitk.WriteImage(sitk.JoinSeries([image]), path("four_axes.mha"), True)
sitk.WriteImage(sitk.JoinSeries([image]), path("four_axes.nii.gz"), True)
axes = np.vstack([[np.nan] * 3, (R * np.array(SPACING)).T])
header = {"space": "left-posterior-superior", "space directions": axes, "space origin": FIRST, "encoding": "gzip"}
nrrd.write(path("four_axes.nrrd"), CT.astype(np.int16).T[None], header)


def of_image(image):
    array = sitk.GetArrayFromImage(image)
    if image.GetDimension() == 4:
        image = image[..., 0]
        array = array[0]
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(image.GetDirection()).reshape(3, 3) * np.array(image.GetSpacing())
    matrix[:3, 3] = image.GetOrigin()
    return array, matrix


def of_series(folder):
    """As SimpleITK reads it; the values of compressed ones as pydicom does, which is the other reader."""
    names = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(folder)
    array, matrix = of_image(sitk.ReadImage(names))
    sets = [pydicom.dcmread(name) for name in names]
    other = np.stack([d.pixel_array * float(d.RescaleSlope) + float(d.RescaleIntercept) for d in sets])
    assert np.array_equal(array, other), folder
    return array, matrix


def truth(array, matrix):
    voxels = hashlib.sha256(array.astype("<f4").tobytes()).hexdigest()
    return {"size": list(array.shape[::-1]), "sha256": voxels, "t_lps_voxel": matrix.tolist()}


all_of = {}
for name in sorted(os.listdir(HERE)):
    if name in ("make.py", "detached.zraw", "jpeg_lossless_point", "jpeg_12_bits", "jpeg_2000_high_throughput"):
        continue
    if name == "study":
        _, matrix = of_series(path("jpeg_2000"))
        all_of[name] = truth(of_series(path("jpeg_2000"))[0], matrix)
    elif name == "enhanced.dcm":
        d = pydicom.dcmread(path(name))
        shift = [float(f.PixelValueTransformationSequence[0].RescaleIntercept) for f in d.PerFrameFunctionalGroupsSequence]
        _, matrix = of_series(path("plain"))
        all_of[name] = truth(d.pixel_array + np.array(shift)[:, None, None], matrix)
    elif name == "without_preamble":
        # Neither reads it without being forced: dcmtk wrote it from the series beside it.
        all_of[name] = truth(*of_series(path("plain")))
    elif os.path.isdir(path(name)):
        all_of[name] = truth(*of_series(path(name)))
    elif name == "four_axes.nrrd":
        voxels, header = nrrd.read(path(name))
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = header["space directions"][1:].T, header["space origin"]
        all_of[name] = truth(voxels[0].T, matrix)
    else:
        all_of[name] = truth(*of_image(sitk.ReadImage(path(name))))
json.dump(all_of, open(path("truth.json"), "w"), indent=1)
