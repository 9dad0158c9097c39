//! The files that hostile ones are made from.

use crate::{border, targets::Target};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Longer files are cut, so that many are tried.
const MAX_SEED_BYTES: usize = 60_000;
/// Files of the repository that a target reads, with their endings.
pub(crate) fn seeds(target: &Target, root: &Path) -> Vec<(String, Vec<u8>)> {
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
        bytes.truncate(MAX_SEED_BYTES);
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
        ],
        "picked_points" => &[
            ("csv", "name,x,y,z\nP1,1,2,3\n"),
            ("pp", "<PickedPoints><point x=\"1\" y=\"2\" z=\"3\" name=\"P1\" active=\"1\"/></PickedPoints>"),
        ],
        "pose" => &[
            ("txt", "1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n"),
            (
                "tfm",
                "#Insight Transform File V1.0\nTransform: AffineTransform_double_3_3\nParameters: 1 0 0 0 1 0 0 0 1 5 6 7\nFixedParameters: 0 0 0\n",
            ),
        ],
        "region" => &[(
            "json",
            "{\"format\":\"osteoflow.region\",\"version\":1,\"frame\":\"camera\",\"keep\":[{\"box\":{\"center\":[0,0,0],\"size\":[1,1,1]}}]}",
        )],
        "volume" => &[(
            "nrrd",
            "NRRD0004\ntype: short\ndimension: 3\nspace: left-posterior-superior\nsizes: 2 2 2\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nkinds: domain domain domain\nendian: little\nencoding: raw\nspace origin: (0,0,0)\n\n0123456789abcdef",
        )],
        "openigtlink" => &[("bin", "\0\u{1}TRANSFORM\0\0\0StylusToReference\0\0\0")],
        _ => &[],
    };
    seeds.extend(made.iter().map(|(ending, text)| ((*ending).to_owned(), text.as_bytes().to_vec())));
    let border: Vec<Vec<u8>> = match target.name {
        "payload" => (0..=255)
            .map(|first| (0..400).map(|n| if n == 0 { first } else { (n * 37 + 90) as u8 }).collect())
            .collect(),
        "plugin_description" => vec![border::description().into_bytes()],
        "process" => border::sent_by_processes(),
        _ => Vec::new(),
    };
    seeds.extend(border.into_iter().map(|bytes| (target.endings[0].to_owned(), bytes)));
    assert!(!seeds.is_empty(), "{} has no seed", target.name);
    seeds
}
