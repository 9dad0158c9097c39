use super::*;
use crate::Space;
use nalgebra::{Point3, Rotation3, Vector3};
use osteoflow_geometry::{NamedPoint, Plane};

fn read(text: &str) -> Result<PickedPoints, FileError> {
    parse_picked_points("a.file".as_ref(), text.as_bytes())
}

fn said(text: &str) -> String {
    read(text).map_or_else(|error| error.to_string(), |content| panic!("{content:?}"))
}

fn named(content: &PickedPoints) -> Vec<(&str, [f64; 3])> {
    content.points.iter().map(|p| (&*p.name, p.position.coords.into())).collect()
}

fn markups(inner: &str) -> String {
    format!(r#"{{"markups":[{{{inner}}}]}}"#)
}

fn at(plane: &Plane) -> Point3<f64> {
    plane.isometry().unwrap() * Point3::origin()
}

const TWO: [(&str, [f64; 3]); 2] = [("P1", [1.0, 2.5, -3.0]), ("P 2", [4.0, 5.0, 6.0])];

#[test]
fn a_comment_that_states_another_unit_is_refused_by_its_line() {
    let list = |unit: &str| format!("# units: {unit}\nlabel,x,y,z\nP1,1,2.5,-3\nP 2,4,5,6\n");
    assert_eq!(named(&read(&list("mm")).unwrap()), TWO);
    for (unit, mm) in [("m", "1000"), ("inches", "25.4")] {
        let said = said(&list(unit));
        assert!(said.contains("line 1: the file states") && said.contains(mm), "{said}");
    }
}

#[test]
fn the_same_points_are_read_from_every_format() {
    let point =
        |label: &str, p: [f64; 3]| format!(r#"{{"label":"{label}","position":{p:?},"positionStatus":"defined"}}"#);
    let list = |sign: f64| TWO.map(|(name, [x, y, z])| point(name, [sign * x, sign * y, z])).join(",");
    let json = |system: &str, sign: f64, kind: &str| {
        markups(&format!(r#""type":"{kind}","coordinateSystem":{system},"controlPoints":[{}]"#, list(sign)))
    };
    let fcsv = |system: &str, sign: f64| {
        let row = |(name, [x, y, z]): (&str, [f64; 3])| {
            format!("id,{},{},{z},0,0,0,1,1,1,0,{name},,,2,0\n", sign * x, sign * y)
        };
        format!("# Markups fiducial file version = 4.11\n# CoordinateSystem = {system}\n{}", TWO.map(row).join(""))
    };
    for (text, space) in [
        (json("\"LPS\"", 1.0, "Fiducial"), Space::Lps),
        (json("\"RAS\"", -1.0, "Curve"), Space::Ras),
        (json("0", -1.0, "Line"), Space::Ras),
        (json("\"1\"", 1.0, "ClosedCurve"), Space::Lps),
        (fcsv("LPS", 1.0), Space::Lps),
        (fcsv("0", -1.0), Space::Ras),
        ("P1,1,2.5,-3\nP 2,4,5,6\n".into(), Space::Unknown),
        ("P1 1 2.5 -3\nP 2 4 5 6\n".into(), Space::Unknown),
        ("P1;1,0;2,5;-3,0\r\nP 2;4,0;5,0;6,0\r\n".into(), Space::Unknown),
        ("label,x,y,z\nP1,1,2.5,-3\n\"P 2\",4,5,6\n".into(), Space::Unknown),
        ("# these are x, y and z\n//Name,Z,Y,X\nP1,-3,2.5,1\nP 2,6,5,4\n".into(), Space::Unknown),
        ("# SPACE=RAS\nz,y,x,Name\n-3,-2.5,-1,P1\n6,-5,-4,P 2\n".into(), Space::Ras),
        (
            "<!DOCTYPE PickedPoints>\n<PickedPoints>\n <point y=\"2.5\" active=\"1\" name=\"P1\" x=\"1\" z=\"-3\"/>\n \
             <point x=\"4\" y=\"5\" z=\"6\" name=\"P 2\"/>\n</PickedPoints>\n"
                .into(),
            Space::Unknown,
        ),
    ] {
        let content = read(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert_eq!(named(&content), TWO, "{text}");
        assert_eq!((content.space, content.is_named, content.n_skipped), (space, true, 0), "{text}");
        assert_eq!(content.notes.len(), usize::from(space == Space::Ras), "{:?}\n{text}", content.notes);
    }
}

#[test]
fn points_without_a_name_are_called_by_their_place() {
    for (text, n_notes) in
        [("1 2 3\n4 5 6\n", 0), ("x,y,z\n1,2,3\n4,5,6\n", 0), ("7,1,2,3\n9,4,5,6\n", 1), ("0 1 2 3\n1 4 5 6\n", 1)]
    {
        let content = read(text).unwrap();
        assert_eq!(named(&content), [("1", [1.0, 2.0, 3.0]), ("2", [4.0, 5.0, 6.0])], "{text}");
        assert_eq!((content.is_named, content.notes.len()), (false, n_notes), "{text}");
    }
    let content = read("#0,1,2,3\n#1,4,5,6\n").unwrap();
    assert_eq!(named(&content), [("#0", [1.0, 2.0, 3.0]), ("#1", [4.0, 5.0, 6.0])]);
    let content = read("P1,1,2,3\n,4,5,6\n").unwrap();
    assert_eq!(named(&content)[1].0, "2");
    assert_eq!(content.notes, ["1 of 2 points have no name and are called by their place in the list"]);
    assert!(!content.is_named);
}

#[test]
fn points_that_are_not_placed_or_inactive_are_passed_over_and_counted() {
    let point =
        |label: &str, status: &str| format!(r#"{{"label":"{label}","position":[1,2,3],"positionStatus":"{status}"}}"#);
    let points = ["defined", "undefined", "missing", "preview"].map(|status| point(status, status)).join(",");
    let text = markups(&format!(r#""type":"Fiducial","coordinateSystem":"LPS","controlPoints":[{points}]"#));
    let content = read(&text).unwrap();
    assert_eq!((content.points.len(), content.n_skipped), (1, 3));
    let text = "<PickedPoints><point x=\"1\" y=\"2\" z=\"3\" active=\"0\" name=\"a\"/></PickedPoints>";
    assert!(said(text).contains("there is no point in the file; 1 were passed over"), "{}", said(text));
    let text = "# CoordinateSystem = LPS\n1,0,0,0,0,0,0,1,1,1,0,A,,,0,0\n2,1,2,3,0,0,0,1,1,1,0,B,,,2,0\n";
    let content = read(text).unwrap();
    assert_eq!((named(&content), content.n_skipped), (vec![("B", [1.0, 2.0, 3.0])], 1));
}

#[test]
fn planes_and_boxes_are_read_and_turned_to_lps() {
    let text = markups(
        r#""type":"Plane","name":"cut","coordinateSystem":"RAS","coordinateUnits":["mm","UCUM","millimeter"],
           "center":[1,2,3],"normal":[0,2,0],"controlPoints":[{"label":"a","position":[1,2,3]}]"#,
    );
    let content = read(&text).unwrap();
    assert_eq!(content.points, []);
    let plane = &content.planes[0];
    assert_eq!((&*plane.name, at(plane)), ("cut", Point3::new(-1.0, -2.0, 3.0)));
    assert!((plane.normal().unwrap() + Vector3::y()).norm() < 1e-12);
    let text = markups(
        r#""type":"Plane","coordinateSystem":"LPS","controlPoints":[{"label":"a","position":[0,0,5]},
           {"label":"b","position":[1,0,5]},{"label":"c","position":[0,1,5]}]"#,
    );
    let content = read(&text).unwrap();
    assert_eq!((&*content.planes[0].name, content.planes[0].normal()), ("a", Some(Vector3::z())));
    assert_eq!(content.notes, ["plane \"a\" has no normal; it is taken through its three points"]);
    let text = markups(
        r#""type":"ROI","roiType":"Box","coordinateSystem":"RAS","center":[1,2,3],"size":[10,20,30],
           "orientation":[0,-1,0,1,0,0,0,0,1],"controlPoints":[]"#,
    );
    let content = read(&text).unwrap();
    let roi = &content.rois[0];
    assert_eq!(
        (&*roi.name, roi.center, roi.size_mm),
        ("roi_1", Point3::new(-1.0, -2.0, 3.0), Vector3::new(10.0, 20.0, 30.0))
    );
    // The first axis is y in RAS.
    assert!((roi.axes * Vector3::x() + Vector3::y()).norm() < 1e-12, "{}", roi.axes);
}

#[test]
fn a_broken_file_says_where_and_why() {
    let fiducial = |inner: &str| markups(&format!(r#""type":"Fiducial",{inner}"#));
    for (text, expected) in [
        (fiducial(r#""coordinateSystem":"LAS""#), "markups[0].coordinateSystem: \"LAS\" is no coordinate system"),
        (
            fiducial(r#""coordinateUnits":"in""#),
            "markups[0].coordinateUnits: the unit is \"in\", which is none of mm, um, cm and m; save the markups in mm",
        ),
        (
            fiducial(r#""controlPoints":[{"label":"a","position":[1,2]}]"#),
            "markups[0].controlPoints[0].position: 3 finite numbers are expected",
        ),
        (
            fiducial(r#""controlPoints":[{"label":"a","position":[1,2,3]},{"label":"a","position":[1,2,4]}]"#),
            "markups[0].controlPoints[1]: label \"a\" is given twice",
        ),
        (
            fiducial(r#""controlPoints":[{"label":"a","position":[1,2,3],"positionStatus":"lost"}]"#),
            "markups[0].controlPoints[0].positionStatus: \"lost\" is unknown",
        ),
        (markups(r#""type":"Plane","center":[0,0,0],"normal":[0,0,0]"#), "markups[0].normal: "),
        (markups(r#""type":"ROI","center":[0,0,0],"size":[0,1,1]"#), "markups[0].size: three edges above 0"),
        (markups(r#""type":"Text""#), "markups[0].type: \"Text\" is not read"),
        ("{\"markups\":\n[{]}".into(), "line 2 column 3: "),
        ("{\"a\":1}".into(), "markups: there is no list \"markups\""),
        ("# CoordinateSystem = ABC\n".into(), "line 1: \"ABC\" is no coordinate system"),
        ("# CoordinateSystem = LPS\n1,2,3\n".into(), "line 2: 14 columns are expected, this line has 3"),
        ("# CoordinateSystem = LPS\n1,2,nan,3,0,0,0,1,1,1,0,A,,\n".into(), "line 2: point \"A\" is at [2.0, NaN, 3.0]"),
        ("P1,1,2,3\nP1,4,5,6\n".into(), "line 2: label \"P1\" is given twice"),
        ("P1,1,2,3\nP2,4,5\n".into(), "line 2: 4 columns are expected, this line has 3"),
        ("1 2 3 0 0 1\n".into(), "line 1: a label and three numbers are expected, this line has 6 columns"),
        ("1 2 3\n1 2 3 4 5\n".into(), "line 2: 3 columns are expected, this line has 5"),
        ("P1,1,two,3\n".into(), "line 1: \"two\" is not a number"),
        ("P1,1,2,3,4\n".into(), "line 1: a label and three numbers are expected, this line has 5 columns"),
        ("label,x,y,q\nP1,1,2,3\n".into(), "line 1: no column is called \"z\"; there are: label, x, y, q"),
        ("label,x,y,z,x\nP1,1,2,3,4\n".into(), "line 1: column 5 is called \"x\" as one before it is"),
        ("label,x,y,z\nP1,1,2,inf\n".into(), "line 2: point \"P1\" is at"),
        ("<PickedPoints><point x=\"1\" y=\"2\"/></PickedPoints>".into(), "line 1: the point has no z"),
        (
            "<PickedPoints>\n<point x=\"1\" y=\"b\" z=\"2\"/></PickedPoints>".into(),
            "line 2: y is \"b\"; a number is expected",
        ),
        ("<PickedPoints>\n<point".into(), "line 1: the root node was opened but never closed"),
        ("<html></html>".into(), "line 1: the XML holds \"html\""),
        ("<!DOCTYPE a [<!ENTITY b \"c\">]><a/>".into(), "entities in XML are not read"),
        (String::new(), "byte 0: the file is empty"),
        ("# nothing\n".into(), "there is no point in the file"),
        ("ply\n".into(), "it holds a cloud of points (PLY), and a list of points is needed"),
        ("\u{89}PNG\0\0".into(), "byte 0: it is of no known format, and a list of points is needed"),
    ] {
        let said = said(&text);
        assert!(said.contains(expected), "{expected}\n{said}");
    }
}

#[test]
fn a_file_that_states_no_space_is_noted_and_contradictions_are_refused() {
    let point = r#""controlPoints":[{"label":"a","position":[1,2,3]}]"#;
    let content = read(&markups(&format!(r#""type":"Fiducial",{point}"#))).unwrap();
    assert_eq!((content.space, named(&content)), (Space::Unknown, vec![("a", [1.0, 2.0, 3.0])]));
    assert_eq!(content.notes, ["the file states no coordinate system; its numbers are taken as they are"]);
    let text =
        r#"{"markups":[{"type":"Fiducial","coordinateSystem":"LPS"},{"type":"Fiducial","coordinateSystem":"RAS"}]}"#;
    assert!(said(text).contains("markups[1].coordinateSystem: it is RAS, but LPS for the first"), "{}", said(text));
}

#[test]
fn points_survive_being_written_in_either_space() {
    let points = [("P1", [1.0 / 3.0, -2.5e-7, 210.0]), ("a \"b\", c", [-0.5, 4.0, 1e6]), ("#3", [1.0, 2.0, 3.0])]
        .map(|(name, p)| NamedPoint::new(name, p.into()));
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("points");
    type Write = fn(&Path, &[NamedPoint], Space) -> Result<(), FileError>;
    for (write, states) in [(write_mrk_json as Write, true), (write_fcsv, true), (write_points_csv, false)] {
        for space in [Space::Lps, Space::Ras, Space::Unknown] {
            let written = write(&path, &points, space);
            if states && space == Space::Unknown {
                let said = written.unwrap_err().to_string();
                assert!(
                    said.contains("space: the format states LPS or RAS, but the space of the points is unknown"),
                    "{said}"
                );
                continue;
            }
            written.unwrap();
            let back = read_picked_points(&path).unwrap();
            assert_eq!((&back.points[..], back.space), (&points[..], space));
        }
    }
    assert!(write_fcsv(&path, &[NamedPoint::new("a\nb", Point3::origin())], Space::Lps).is_err());
}

#[test]
fn a_box_is_read_as_it_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("roi.mrk.json");
    let (min, max) = (Point3::new(-60.0, -40.0, 150.0), Point3::new(60.0, 41.0, 250.0));
    write_roi_mrk_json(&path, "region", &min, &max).unwrap();
    let read = read_picked_points(&path).unwrap();
    let [roi] = &read.rois[..] else { panic!("{} boxes", read.rois.len()) };
    assert_eq!((&*roi.name, roi.center, roi.size_mm), ("region", Point3::new(0.0, 0.5, 200.0), max - min));
    assert_eq!(roi.axes, Rotation3::identity());
}
