//! The files that hostile ones are made from.

#[cfg(unix)]
use super::border;
use super::layouts::{Encoding, Layout, recording_bytes};
use super::targets::{IMAGE_SIZE, MESSAGES, TARGETS, Target};
use foxglove::{
    Encode,
    messages::{CameraCalibration, CompressedImage, RawImage},
};
use osteoflow_formats::{
    mcap_read::Recording,
    message_read::{CAMERA_CALIBRATION, COMPRESSED_IMAGE, RAW_IMAGE},
    openigtlink::{
        Affine, Body, Cells, Fiducial, Message, Metadata, PixelImage, PolyData, Position, Scalar, Status, TrackedTool,
    },
    recording_write::Stream,
};
use osteoflow_geometry::{
    Cloud, Pose,
    nalgebra::{Isometry3, Point3, Vector3},
};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Longer files are cut, so that many are tried.
pub(crate) const MAX_SEED_BYTES: usize = 60_000;

/// Files of the repository that a target reads, with their endings.
pub(crate) fn seeds(target: &Target, root: &Path) -> Vec<(String, Vec<u8>)> {
    if target.name == "probe" {
        // What the others read.
        let others = TARGETS.iter().filter(|other| other.name != target.name);
        let all = others.flat_map(|other| seeds(other, root));
        return all.filter(|(ending, _)| target.endings.contains(&&**ending)).collect();
    }
    let mut folders: Vec<PathBuf> = ["tests/data", "graphs"].iter().map(|folder| root.join(folder)).collect();
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { folders.push(path) } else { files.push(path) }
        }
    }
    files.sort();
    let ending = |path: &Path| path.extension().unwrap_or_default().to_string_lossy().into_owned();
    let read = |path: &PathBuf| {
        let mut bytes = fs::read(path).unwrap();
        if bytes.len() > MAX_SEED_BYTES {
            // At the end of a line, so that tables are whole.
            let end =
                bytes[..MAX_SEED_BYTES].iter().rposition(|byte| *byte == b'\n').map_or(MAX_SEED_BYTES, |at| at + 1);
            bytes.truncate(end);
        }
        (ending(path), bytes)
    };
    let mut seeds: Vec<_> =
        files.iter().filter(|path| target.endings.contains(&&*ending(path))).map(read).take(12).collect();
    let made: &[(&str, &str)] = match target.name {
        "surface_or_cloud" => &[
            ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n"),
            ("off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
            ("xyz", "0 0 0 0 0 1\n1 2 3 0 0 1\n"),
            (
                "ply",
                "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
            ),
            (
                "stl",
                "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n",
            ),
            (
                "pcd",
                "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n0 0 0\n1 2 3\n",
            ),
            (
                "vtk",
                "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\nPOLYGONS 1 4\n3 0 1 2\n",
            ),
            (
                "vtp",
                "<VTKFile type=\"PolyData\" byte_order=\"LittleEndian\" header_type=\"UInt32\" compressor=\"vtkZLibDataCompressor\"><PolyData>\
                 <Piece NumberOfPoints=\"4\" NumberOfPolys=\"1\"><Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"binary\">\
                 AQAAAACAAAAwAAAAEwAAAA==eF5jYEAGAo6obHQ+gz0AGLsBhA==</DataArray></Points><Polys>\
                 <DataArray type=\"Int64\" Name=\"connectivity\" format=\"binary\">AQAAAACAAAAgAAAAEwAAAA==eF5jYIAARijNBKWZoTQAAHAABw==</DataArray>\
                 <DataArray type=\"Int64\" Name=\"offsets\" format=\"binary\">AQAAAACAAAAIAAAACwAAAA==eF5jYYAAAAAoAAU=</DataArray></Polys></Piece></PolyData></VTKFile>",
            ),
            (
                "vtp",
                "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"1\"><Points><DataArray type=\"Float32\" format=\"appended\" \
                 offset=\"0\"/></Points></Piece></PolyData><AppendedData encoding=\"raw\">_\u{c}\0\0\0abc?abc?abc?</AppendedData></VTKFile>",
            ),
        ],
        "picked_points" => &[
            ("csv", "name,x,y,z\nP1,1,2,3\n"),
            ("txt", "1 2 3\n4 5 6\n"),
            ("pp", "<PickedPoints><point x=\"1\" y=\"2\" z=\"3\" name=\"P1\" active=\"1\"/></PickedPoints>"),
        ],
        "pose" => &[
            ("json", "[[1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]"),
            ("txt", "1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n"),
            (
                "tfm",
                "#Insight Transform File V1.0\nTransform: AffineTransform_double_3_3\nParameters: 1 0 0 0 1 0 0 0 1 5 6 7\nFixedParameters: 0 0 0\n",
            ),
        ],
        "region" => &[(
            "json",
            r#"{ "format": "osteoflow-region", "version": 1, "units": "mm", "frame": "camera",
                 "drawn_on": { "n_points": 20000, "n_inside": 15210 },
                 "keep": [ { "shape": "outline", "eye": [0, 0, 0], "right": [1, 0, 0], "down": [0, 1, 0],
                             "corners": [[-0.3, -0.1], [0.3, -0.1], [0.3, 0.1]] },
                           { "shape": "box", "min": [-60, -40, 150], "max": [60, 40, 250] } ],
                 "cut": [ { "shape": "brush", "centres": [[1, 2, 200], [3, 2, 200]], "radius": 4 },
                          { "shape": "slab", "origin": [0, 0, 0], "direction": [0, 0, 1], "from": -50, "to": 50 } ] }"#,
        )],
        "log" => &[
            ("tum", "# timestamp tx ty tz qx qy qz qw\n1.0 0.1 0.2 0.3 0 0 0 1\n1.1 0.1 0.2 0.3 0 0 0 1\n"),
            (
                "csv",
                "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n1000,0.1,0.2,0.3,1,0,0,0\n",
            ),
            ("txt", "1 0 0 0.1 0 1 0 0.2 0 0 1 0.3\n1 0 0 0.1 0 1 0 0.2 0 0 1 0.4\n"),
            (
                "mha",
                "ObjectType = Image\nNDims = 3\nDimSize = 0 0 0\nElementType = MET_UCHAR\nSeq_Frame0000_StylusToTrackerTransform = 1 0 0 10 0 1 0 20 0 0 1 30 0 0 0 1\nSeq_Frame0000_StylusToTrackerTransformStatus = OK\nSeq_Frame0000_Timestamp = 1.5\nElementDataFile = LOCAL\n",
            ),
            (
                "nrrd",
                "NRRD0004\nsizes: 0 0 1\nSeq_Frame0000_StylusToTrackerTransform:=1 0 0 10 0 1 0 20 0 0 1 30 0 0 0 1\nSeq_Frame0000_StylusToTrackerTransformStatus:=OK\nSeq_Frame0000_Timestamp:=1.5\n\n",
            ),
            (
                "csv",
                "Format Version,1.23,Rotation Type,Quaternion,Length Units,Meters\n,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body\n,Name,A,A,A,A,A,A,A\n,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position\nFrame,Time (Seconds),X,Y,Z,W,X,Y,Z\n0,0.5,0,0,0,1,1,2,3\n",
            ),
            (
                "csv",
                "Objects\n100\n,,A:A,,,,,,\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm\n1,0,0,0,0,1,1,2,3\n",
            ),
        ],
        "volume" => &[
            (
                "nrrd",
                "NRRD0004\ntype: short\ndimension: 3\nspace: left-posterior-superior\nsizes: 2 2 2\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nkinds: domain domain domain\nendian: little\nencoding: raw\nspace origin: (0,0,0)\n\n0123456789abcdef",
            ),
            (
                "mha",
                "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\nTransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 0 0 0\nElementSpacing = 1 1 1\nDimSize = 2 2 2\nElementType = MET_SHORT\nElementDataFile = LOCAL\n0123456789abcdef",
            ),
        ],
        _ => &[],
    };
    seeds.extend(made.iter().map(|(ending, text)| ((*ending).to_owned(), text.as_bytes().to_vec())));
    let made: Vec<Vec<u8>> = match target.name {
        "procedure" => {
            let folder = root.join("tests/data/folder");
            let text = fs::read_to_string(folder.join("procedure.toml")).unwrap();
            let with_paths = text.lines().map(|line| match line.split('"').collect::<Vec<_>>()[..] {
                [key, name, _] if key.trim_start().starts_with("file") => format!("file = {:?}", folder.join(name)),
                _ => line.to_owned(),
            });
            vec![with_paths.collect::<Vec<_>>().join("\n").into_bytes()]
        }
        "volume" => encoded(root).into_iter().chain([nifti(), dicom()]).collect(),
        "message" => messages_of_recordings(root),
        "openigtlink" => messages().iter().map(|message| message.to_bytes().unwrap()).collect(),
        #[cfg(unix)]
        "payload" => border::items(root),
        #[cfg(unix)]
        "plugin_description" => vec![border::description().into_bytes()],
        #[cfg(unix)]
        "process" => border::sent(root),
        _ => Vec::new(),
    };
    let ending = |bytes: &[u8]| if bytes.get(128..132) == Some(b"DICM") { "dcm" } else { target.endings[0] };
    seeds.extend(made.into_iter().map(|bytes| (ending(&bytes).to_owned(), bytes)));
    assert!(!seeds.is_empty(), "{} has no seed", target.name);
    seeds
}

/// A slice in each encoding of DICOM's pixels.
fn encoded(root: &Path) -> Vec<Vec<u8>> {
    let folders = fs::read_dir(root.join("nodes/bone/formats/tests/data/volumes")).unwrap();
    let mut files: Vec<_> =
        folders.map(|folder| folder.unwrap().path().join("I0")).filter(|file| file.is_file()).collect();
    files.sort();
    files.iter().map(|file| fs::read(file).unwrap()).collect()
}

/// Two voxels in each direction, 1 mm apart, with an sform.
fn nifti() -> Vec<u8> {
    let mut bytes = vec![0; 352 + 16];
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    put(0, &348_i32.to_le_bytes());
    for (k, n) in [3_i16, 2, 2, 2, 1, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * k, &n.to_le_bytes());
        put(76 + 4 * k, &1_f32.to_le_bytes());
    }
    put(70, &4_i16.to_le_bytes());
    put(72, &16_i16.to_le_bytes());
    put(108, &352_f32.to_le_bytes());
    put(123, &[2]);
    put(254, &1_i16.to_le_bytes());
    [280, 300, 320].into_iter().for_each(|at| put(at, &1_f32.to_le_bytes()));
    put(344, b"n+1\0");
    bytes
}

/// A slice of 2 x 2 voxels of CT, 1 mm apart, explicit little endian.
fn dicom() -> Vec<u8> {
    let mut bytes = vec![0; 128];
    bytes.extend(b"DICM");
    let elements: [(u32, &[u8; 2], &[u8]); 17] = [
        (0x0002_0010, b"UI", b"1.2.840.10008.1.2.1\0"),
        (0x0008_0016, b"UI", b"1.2.840.10008.5.1.4.1.1.2\0"),
        (0x0008_0060, b"CS", b"CT"),
        (0x0018_0050, b"DS", b"1.0 "),
        (0x0020_000e, b"UI", b"1.2.3\0"),
        (0x0020_0032, b"DS", b"0\\0\\0 "),
        (0x0020_0037, b"DS", b"1\\0\\0\\0\\1\\0 "),
        (0x0028_0002, b"US", &[1, 0]),
        (0x0028_0004, b"CS", b"MONOCHROME2 "),
        (0x0028_0010, b"US", &[2, 0]),
        (0x0028_0011, b"US", &[2, 0]),
        (0x0028_0030, b"DS", b"1\\1 "),
        (0x0028_0100, b"US", &[16, 0]),
        (0x0028_0101, b"US", &[16, 0]),
        (0x0028_0102, b"US", &[15, 0]),
        (0x0028_0103, b"US", &[0, 0]),
        (0x7fe0_0010, b"OW", b"01234567"),
    ];
    for (tag, representation, value) in elements {
        bytes.extend(((tag >> 16) as u16).to_le_bytes());
        bytes.extend((tag as u16).to_le_bytes());
        bytes.extend(representation);
        if representation == b"OW" {
            bytes.extend([0, 0]);
            bytes.extend((value.len() as u32).to_le_bytes());
        } else {
            bytes.extend((value.len() as u16).to_le_bytes());
        }
        bytes.extend(value);
    }
    bytes
}

/// A message of each schema in each encoding that other programs write.
fn messages_of_recordings(root: &Path) -> Vec<Vec<u8>> {
    let at = 1_750_000_000_000_000_000;
    let points = [[0.0, 0.0, 200.0], [1.0, 0.0, 201.0], [0.0, 1.0, 202.0]].map(Point3::from);
    let normals = vec![-Vector3::z(); 3];
    let cloud = Cloud::new("camera", points.to_vec()).unwrap().with_normals(normals).unwrap().at(at);
    let pose = |name: &str| Pose::new("world", name, Isometry3::translation(1.0, 2.0, 3.0)).at(at);
    let streams = [
        ("/cloud", Stream::Clouds(vec![cloud])),
        ("/tf", Stream::Transforms(vec![pose("bone_marker"), pose("camera_marker")])),
        ("/tip", Stream::Tips(vec![("world".into(), at, Point3::new(1.0, 2.0, 3.0))])),
    ];
    let mut all = Vec::new();
    let cdr = |big_endian| Encoding::Cdr { big_endian };
    for encoding in [Encoding::Protobuf, Encoding::Json, cdr(false), cdr(true)] {
        for transforms_per_message in [1, 2] {
            let layout = Layout { encoding, transforms_per_message, ..Layout::default() };
            let bytes = recording_bytes(&streams, &Default::default(), &[], &layout);
            let recording = Recording::from_bytes("seed", &bytes, false).unwrap();
            for message in recording.topics().iter().flat_map(|topic| recording.messages(&topic.name)) {
                all.push((
                    message.schema_name.to_string(),
                    message.message_encoding.to_string(),
                    message.data.to_vec(),
                ));
            }
        }
    }
    // Of the pictures that rosbags and OpenCV wrote, those that are read.
    let written = Recording::open(&root.join("tests/data/ros2_images.mcap"), false).unwrap();
    for topic in ["/rgb8", "/bgra8", "/mono16", "/jpeg", "/png", "/brown/info", "/fisheye/info"] {
        let message = &written.messages(topic)[0];
        all.push((message.schema_name.to_string(), message.message_encoding.to_string(), message.data.to_vec()));
    }
    let [width, height] = IMAGE_SIZE;
    let frame_id = || "camera".to_owned();
    let pixels = vec![7; 3 * (width * height) as usize];
    let mut packed = Vec::new();
    let mut png = png::Encoder::new(&mut packed, width, height);
    png.set_color(png::ColorType::Rgb);
    png.write_header().unwrap().write_image_data(&pixels).unwrap();
    let raw = RawImage {
        width,
        height,
        encoding: "rgb8".into(),
        step: 3 * width,
        data: pixels.into(),
        frame_id: frame_id(),
        ..RawImage::default()
    };
    let compressed = CompressedImage {
        data: packed.into(),
        format: "png".into(),
        frame_id: frame_id(),
        ..CompressedImage::default()
    };
    let k = vec![14.0, 0.0, 7.0, 0.0, 14.0, 5.0, 0.0, 0.0, 1.0];
    let calibration = CameraCalibration { width, height, k, frame_id: frame_id(), ..CameraCalibration::default() };
    let mut protobuf = |schema: &str, encode: &dyn Fn(&mut Vec<u8>)| {
        let mut data = Vec::new();
        encode(&mut data);
        all.push((schema.to_owned(), "protobuf".into(), data));
    };
    protobuf(RAW_IMAGE, &|data| raw.encode(data).unwrap());
    protobuf(COMPRESSED_IMAGE, &|data| compressed.encode(data).unwrap());
    protobuf(CAMERA_CALIBRATION, &|data| calibration.encode(data).unwrap());
    let seed = |(schema, encoding, data): (String, String, Vec<u8>)| {
        let is_its = |known: &(&str, &str)| *known == (schema.as_str(), encoding.as_str());
        let first = MESSAGES.iter().position(is_its).unwrap_or_else(|| panic!("{schema} in {encoding} has no target"));
        [vec![first as u8], data].concat()
    };
    all.into_iter().map(seed).collect()
}

/// A message of each kind, in both versions of the header.
fn messages() -> Vec<Message> {
    let affine = Affine([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 10.0, 20.0, 30.0]);
    let triangle = PolyData {
        points: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        polygons: Cells::new([[0, 1, 2]]),
        ..PolyData::default()
    };
    let bodies = [
        Body::Transform(affine),
        Body::Tracking(vec![TrackedTool { name: "Stylus".into(), kind: 1, matrix: affine }]),
        Body::Positions(vec![Position {
            name: String::new(),
            position: [1.0; 3],
            quaternion: Some([0.0, 0.0, 0.0, 1.0]),
        }]),
        Body::Points(vec![Fiducial::new("P1", [1.0, 2.0, 3.0])]),
        Body::PolyData(triangle),
        Body::Image(PixelImage::new([2, 2], 3, Scalar::F32, vec![0; 48])),
        Body::Status(Status::new(Status::OK, "OK", "well")),
        Body::Text("text".into()),
        Body::StartTracking { interval_ms: 50, coordinates: "Reference".into() },
    ];
    let versions = bodies.into_iter().map(|body| Message::new("StylusToReference", 1_750_000_000_000_000_000, body));
    versions.flat_map(|message| [message.clone(), message.extended(7, vec![Metadata::new("key", "value")])]).collect()
}
