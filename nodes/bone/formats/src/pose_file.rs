//! One rigid motion in a file: a 4 × 4 matrix as text or JSON, an ITK transform, or the output of `osteoflow register`; and to
//! an ITK transform.
//!
//! | File | Taken for |
//! |---|---|
//! | 16 numbers, row by row, between blanks, commas, semicolons or brackets; `#`, `//` and `%` begin a comment | the matrix |
//! | JSON: 16 numbers, four rows of four, or an object with such under `T`, `t_target_source` or `matrix` | the matrix |
//! | ITK `.tfm` or `.txt` that begins with `#Insight Transform File`: one linear transform, the identity, or a composite of such | the **inverse** of what it holds |
//!
//! An ITK transform takes points of the fixed image to the moving one, and 3D Slicer writes the inverse of the transform
//! it shows; so the motion of a model onto another is the inverse of its file. Such files are LPS, as CT is here.

use crate::{FileError, input, json, kind::marked, space::check_comments};
use nalgebra::{Isometry3, Matrix3, Matrix4, Quaternion, Rotation3, Vector3};
use osteoflow_geometry::{Correction, Nearest, nearest_isometry, nearest_rotation};
use serde_json::Value;
use std::path::Path;

/// The keys under which a JSON object may hold the matrix, in the order in which they are looked for.
pub(crate) const KEYS: [&str; 3] = ["T", "t_target_source", "matrix"];

/// Keys that may state the unit of length.
const UNITS: [&str; 2] = ["units", "unit"];

/// A matrix with as many digits as there are, and comments, is shorter.
const MAX_MATRIX_BYTES: usize = 4096;

const ITK_MARK: &str = "#Insight Transform File";

/// A rigid motion read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseRead {
    /// The motion, translation in mm.
    pub isometry: Isometry3<f64>,
    /// Changes to the numbers, one sentence each.
    pub notes: Vec<String>,
}

/// Reads a rigid motion from a text, JSON or ITK file, recognised by its content; see [the module](self).
///
/// `unit_mm` is the unit of its translation in mm: 1 for millimetres. The rotation may be rounded: the nearest rotation is
/// taken, and a note says how far it is from the numbers.
///
/// # Errors
/// [`FileError`] if the file cannot be read, holds no 16 numbers, or the matrix projects, mirrors, or is farther than
/// [`ROUNDED_ROTATION`](osteoflow_geometry::ROUNDED_ROTATION) from a rotation.
pub fn read_pose(path: &Path, unit_mm: f64) -> Result<PoseRead, FileError> {
    parse_pose(path, &input::read(path)?, unit_mm)
}

/// The motion in the bytes of a file, as [`read_pose`].
pub(crate) fn parse_pose(path: &Path, bytes: &[u8], unit_mm: f64) -> Result<PoseRead, FileError> {
    if let Some(found) = marked(path, bytes) {
        return Err(found.refusal(path, "a rigid motion"));
    }
    let text = std::str::from_utf8(bytes)
        .map_err(|error| fault(path, format!("byte {}", error.valid_up_to()), "no text; a 4 x 4 matrix is expected"))?;
    let text = text.trim_start_matches('\u{feff}');
    if !text.trim_start().starts_with('{') {
        check_comments(path, text.as_bytes(), unit_mm)?;
    }
    let (mut notes, mut stated) = (Vec::new(), Correction::default());
    let mut matrix = match text.trim_start() {
        itk if itk.starts_with(ITK_MARK) => {
            notes.push("an ITK transform leads from fixed to moving; its inverse is taken".into());
            let (matrix, n_parts) = itk_matrix(path, itk)?;
            if n_parts > 1 {
                notes.push(format!(
                    "a composite of {n_parts} transforms, of which the last is applied first; their product is taken"
                ));
            }
            let nearest = rigid(path, &matrix.value)?;
            stated = if matrix.correction > nearest.correction { matrix.correction } else { nearest.correction };
            nearest.value.inverse().to_homogeneous()
        }
        json if json.starts_with('{') => json_matrix(path, json)?,
        // A list may also be one that numpy printed, which is no JSON.
        list if list.starts_with('[') && serde_json::from_str::<serde::de::IgnoredAny>(list).is_ok() => {
            json_matrix(path, list)?
        }
        _ => sixteen(path, &text_numbers(path, text)?)?,
    };
    for row in 0..3 {
        matrix[(row, 3)] *= unit_mm;
    }
    let Nearest { value: isometry, correction } = rigid(path, &matrix)?;
    let correction = if stated > correction { stated } else { correction };
    if !correction.is_noise() {
        notes
            .push(format!("the rotation is rounded, and the nearest rotation is used; the correction is {correction}"));
    }
    Ok(PoseRead { isometry, notes })
}

/// The text of an ITK transform (`.tfm`) that shows as `t_to_from` in 3D Slicer: the file holds its **inverse**, as Slicer's do.
///
/// `t_to_from` is in millimetres, in LPS; `comments` are lines for the reader, as which frames it leads between.
pub fn itk_text(t_to_from: &Isometry3<f64>, comments: &[String]) -> String {
    let inverse = t_to_from.inverse();
    let rotation = inverse.rotation.to_rotation_matrix();
    let mut numbers: Vec<String> = rotation.matrix().transpose().iter().map(|c| format!("{c:?}")).collect();
    numbers.extend(inverse.translation.vector.iter().map(|c| format!("{c:?}")));
    let comments: String = comments.iter().map(|line| format!("# {}\n", line.replace(['\n', '\r'], " "))).collect();
    format!(
        "{ITK_MARK} V1.0\n{comments}#Transform 0\nTransform: AffineTransform_double_3_3\nParameters: {}\nFixedParameters: 0 0 0\n",
        numbers.join(" ")
    )
}

fn fault(path: &Path, place: impl Into<String>, message: impl Into<String>) -> FileError {
    FileError::content(path, place, message)
}

fn rigid(path: &Path, matrix: &Matrix4<f64>) -> Result<Nearest<Isometry3<f64>>, FileError> {
    nearest_isometry(matrix).map_err(|error| fault(path, "matrix", error.to_string()))
}

/// Whether a text is an ITK transform, or 16 numbers in one, four or sixteen lines that end as a rigid motion does, 0 0 0 1.
pub(crate) fn is_pose(bytes: &[u8]) -> bool {
    let bytes = bytes.trim_ascii_start();
    let text = || std::str::from_utf8(bytes).ok();
    let n_lines = |text: &str| text.lines().filter(|line| line.contains(|c: char| c.is_ascii_digit())).count();
    let is_matrix = |text: &str| {
        let numbers = text_numbers(Path::new(""), text).unwrap_or_default();
        numbers.len() == 16 && numbers[12..] == [0.0, 0.0, 0.0, 1.0] && !matches!(n_lines(text), 2 | 8)
    };
    bytes.starts_with(ITK_MARK.as_bytes()) || bytes.len() <= MAX_MATRIX_BYTES && text().is_some_and(is_matrix)
}

/// The numbers of a text, between blanks, semicolons, brackets or commas, which are decimal in lines of four or sixteen other words.
fn text_numbers(path: &Path, text: &str) -> Result<Vec<f64>, FileError> {
    let mut numbers = Vec::new();
    for (line, row) in text.lines().enumerate() {
        let end = ["#", "//", "%"].iter().filter_map(|mark| row.find(mark)).min().unwrap_or(row.len());
        let between = |c: char| c.is_whitespace() || ";[]()".contains(c);
        let words = || row[..end].split(between).filter(|word| !word.is_empty());
        let decimal = words().map(|word| word.replace(',', ".").parse().ok()).collect::<Option<Vec<f64>>>();
        if let Some(decimal) = decimal.filter(|row| matches!(row.len(), 4 | 16)) {
            numbers.extend(decimal);
            continue;
        }
        for word in words().flat_map(|word| word.split(',')).filter(|word| !word.is_empty()) {
            let number: f64 = word
                .parse()
                .map_err(|_| fault(path, format!("line {}", line + 1), format!("\"{word}\" is not a number")))?;
            numbers.push(number);
        }
    }
    Ok(numbers)
}

fn sixteen(path: &Path, numbers: &[f64]) -> Result<Matrix4<f64>, FileError> {
    if numbers.len() == 16 {
        return Ok(Matrix4::from_row_slice(numbers));
    }
    let message = format!("16 numbers are expected, a 4 x 4 matrix row by row, but there are {}", numbers.len());
    Err(fault(path, "matrix", message))
}

fn json_matrix(path: &Path, text: &str) -> Result<Matrix4<f64>, FileError> {
    let value: Value = json::parse(text)
        .map_err(|error| fault(path, format!("line {}", error.line()), format!("no JSON: {error}")))?;
    let mut matrix = &value;
    // `t_target_source` of a run's results is an object with `matrix` in it.
    while let Some(object) = matrix.as_object() {
        let there: Vec<&str> = KEYS.into_iter().filter(|key| object.contains_key(*key)).collect();
        if let [first, second, ..] = there[..] {
            let message = format!("the keys {first} and {second} are both there; which of them is the pose?");
            return Err(fault(path, "object", message));
        }
        // `register` writes the unit of its angles, too.
        let is_mm = |unit: &Value| *unit == "mm" || *unit == "mm, rad";
        if let Some((key, unit)) = object.iter().find(|(key, unit)| UNITS.contains(&key.as_str()) && !is_mm(unit)) {
            let message = format!("a pose in JSON is in \"mm\", found {unit}; convert its translation to mm");
            return Err(fault(path, format!("key \"{key}\""), message));
        }
        matrix = KEYS.iter().find_map(|key| object.get(*key)).ok_or_else(|| {
            let keys: Vec<_> = object.keys().map(String::as_str).collect();
            let message = format!("none of the keys {} is there; there are: {}", KEYS.join(", "), keys.join(", "));
            fault(path, "object", message)
        })?;
    }
    let rows = matrix.as_array().map(Vec::as_slice).unwrap_or_default();
    let cells: Vec<&Value> = match rows {
        [first, ..] if first.is_array() => {
            if let Some(row) = rows.iter().position(|row| row.as_array().is_none_or(|row| row.len() != 4)) {
                return Err(fault(path, format!("row {}", row + 1), "a row of a 4 x 4 matrix has four numbers"));
            }
            rows.iter().filter_map(Value::as_array).flatten().collect()
        }
        _ => rows.iter().collect(),
    };
    let number = |cell: &&Value| cell.as_f64().ok_or_else(|| fault(path, "matrix", format!("{cell} is no number")));
    sixteen(path, &cells.iter().map(number).collect::<Result<Vec<_>, _>>()?)
}

/// The matrix of an ITK transform as written, with the largest correction of a versor, and its number of parts; a composite is the product of its parts,
/// of which the last is applied first.
fn itk_matrix(path: &Path, text: &str) -> Result<(Nearest<Matrix4<f64>>, usize), FileError> {
    let is_start =
        |line: &str| line.trim().strip_prefix("Transform").is_some_and(|rest| rest.trim_start().starts_with(':'));
    let lines: Vec<&str> = text.lines().collect();
    let starts: Vec<usize> = (0..lines.len()).filter(|k| is_start(lines[*k])).collect();
    let ends = starts.iter().skip(1).copied().chain([lines.len()]);
    let parts: Vec<Part> =
        starts.iter().zip(ends).map(|(start, end)| Part { path, lines: &lines[*start..end] }).collect();
    let Some(first) = parts.first() else {
        return Err(fault(path, "header", "there is no line \"Transform:\"; was the file cut short?"));
    };
    let parts = if first.kind().starts_with("Composite") {
        let parts = &parts[1..];
        // A file does not say how many parts a composite has, but each ends with this line.
        if parts.last().is_none_or(|part| part.line_of("FixedParameters").0.is_none()) {
            return Err(fault(
                path,
                "Transform",
                "a composite whose last part is not complete; was the file cut short?",
            ));
        }
        parts
    } else if parts.len() == 1 {
        &parts[..]
    } else {
        let message = "several transforms that are no composite; harden them into one linear transform and save that";
        return Err(fault(path, "Transform", message));
    };
    let identity = Nearest { value: Matrix4::identity(), correction: Correction::default() };
    let product = parts.iter().try_fold(identity, |product, part| {
        let Nearest { value, correction } = part.matrix()?;
        let correction = if correction > product.correction { correction } else { product.correction };
        Ok(Nearest { value: product.value * value, correction })
    });
    Ok((product?, parts.len()))
}

/// The lines of one transform in an ITK file, from `Transform:` on.
struct Part<'a> {
    path: &'a Path,
    lines: &'a [&'a str],
}

impl Part<'_> {
    /// The value of a key, and whether the key is there again.
    fn line_of(&self, key: &str) -> (Option<&str>, bool) {
        let mut lines =
            self.lines.iter().filter_map(|line| line.trim().strip_prefix(key)?.trim_start().strip_prefix(':'));
        (lines.next().map(str::trim), lines.next().is_some())
    }

    fn kind(&self) -> &str {
        self.line_of("Transform").0.unwrap_or_default()
    }

    /// The matrix as written, about its centre, with the correction of its versor, if it has one.
    fn matrix(&self) -> Result<Nearest<Matrix4<f64>>, FileError> {
        let (path, kind) = (self.path, self.kind());
        let numbers = |key: &str| -> Result<Vec<f64>, FileError> {
            let (line, more) = self.line_of(key);
            if more {
                return Err(fault(path, key, format!("there are two lines \"{key}:\"; save one linear transform")));
            }
            let words = line.unwrap_or_default().split_whitespace();
            let number =
                |word: &str| word.parse::<f64>().map_err(|_| fault(path, key, format!("\"{word}\" is not a number")));
            words.map(number).collect()
        };
        let (parameters, fixed) = (numbers("Parameters")?, numbers("FixedParameters")?);
        let name = kind.split('_').next().unwrap_or(kind);
        let wrong_number = |expected: usize| {
            let message = format!("{expected} numbers are expected, but there are {}", parameters.len());
            fault(path, "Parameters", message)
        };
        let mut correction = Correction::default();
        let (rotation, shift) = match (name, &parameters[..]) {
            ("AffineTransform" | "MatrixOffsetTransformBase" | "Rigid3DTransform", [matrix @ .., x, y, z])
                if matrix.len() == 9 =>
            {
                (Matrix3::from_row_slice(matrix), Vector3::new(*x, *y, *z))
            }
            ("Euler3DTransform", &[a, b, c, x, y, z]) => {
                let turn = |axis: Vector3<f64>, angle: f64| Rotation3::new(axis * angle).into_inner();
                let [rx, ry, rz] = [turn(Vector3::x(), a), turn(Vector3::y(), b), turn(Vector3::z(), c)];
                // The fourth fixed parameter says in which order.
                let zyx = fixed.get(3).is_some_and(|order| *order != 0.0);
                (if zyx { rz * ry * rx } else { rz * rx * ry }, Vector3::new(x, y, z))
            }
            ("VersorRigid3DTransform", &[i, j, k, x, y, z]) => {
                // A versor longer than 1 leaves nothing for w; its quaternion then is too long.
                let w = (1.0 - i * i - j * j - k * k).max(0.0).sqrt();
                let versor = nearest_rotation(Quaternion::new(w, i, j, k))
                    .map_err(|error| fault(path, "Parameters", error.to_string()))?;
                correction = versor.correction;
                (versor.value.to_rotation_matrix().into_inner(), Vector3::new(x, y, z))
            }
            ("IdentityTransform", []) => (Matrix3::identity(), Vector3::zeros()),
            ("TranslationTransform", &[x, y, z]) => (Matrix3::identity(), Vector3::new(x, y, z)),
            ("AffineTransform" | "MatrixOffsetTransformBase" | "Rigid3DTransform", _) => return Err(wrong_number(12)),
            ("Euler3DTransform" | "VersorRigid3DTransform", _) => return Err(wrong_number(6)),
            _ => {
                let message = format!("\"{kind}\" is no rigid transform in 3D; save a linear one");
                return Err(fault(path, "Transform", message));
            }
        };
        let centre = match &fixed[..] {
            [] => Vector3::zeros(),
            [x, y, z, ..] => Vector3::new(*x, *y, *z),
            other => {
                let message = format!("a centre has three numbers, but there are {}", other.len());
                return Err(fault(path, "FixedParameters", message));
            }
        };
        let mut matrix = rotation.to_homogeneous();
        matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&(shift + centre - rotation * centre));
        Ok(Nearest { value: matrix, correction })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn read(text: &str) -> Result<PoseRead, FileError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        read_pose(file.path(), 1.0)
    }

    /// The error for a text, without the file's name.
    fn error_message(text: &str) -> String {
        let message = read(text).unwrap_err().to_string();
        message.split_once(": ").unwrap().1.to_owned()
    }

    fn motion() -> Isometry3<f64> {
        Isometry3::new(Vector3::new(12.5, -3.0, 900.0), Vector3::new(0.3, -0.2, 0.9))
    }

    fn assert_is(pose: &Isometry3<f64>, expected: &Isometry3<f64>, tolerance: f64) {
        let off = (pose.to_homogeneous() - expected.to_homogeneous()).amax();
        assert!(off <= tolerance, "{pose} is {off} from {expected}");
    }

    #[test]
    fn an_itk_transform_that_is_written_reads_as_the_same_motion_and_holds_its_inverse() {
        let text = itk_text(&motion(), &["takes a to b".into(), "two\nlines".into()]);
        assert_is(&read(&text).unwrap().isometry, &motion(), 1e-12);
        let parameters = text.lines().find_map(|line| line.strip_prefix("Parameters: ")).unwrap();
        let numbers: Vec<f64> = parameters.split(' ').map(|n| n.parse().unwrap()).collect();
        let point = Point3::new(10.0, 20.0, -30.0);
        let moved = motion() * point;
        let back = Matrix3::from_row_slice(&numbers[..9]) * moved + Vector3::from_row_slice(&numbers[9..]);
        assert!((back - point).norm() < 1e-9, "{back}");
        let first: Vec<&str> = text.lines().take(4).collect();
        assert_eq!(first, ["#Insight Transform File V1.0", "# takes a to b", "# two lines", "#Transform 0"]);
    }

    fn rows(separator: &str) -> String {
        let rows = osteoflow_geometry::matrix_rows(&motion());
        rows.map(|row| row.map(|c| format!("{c:?}")).join(separator)).join("\n")
    }

    /// As SimpleITK 2.5 writes them.
    #[test]
    fn a_composite_is_the_product_of_its_parts_and_the_identity_is_read() {
        let whole = "Transform: CompositeTransform_double_3_3\n#Transform 1\nTransform: Euler3DTransform_double_3_3\n\
                     Parameters: 0.3 -0.2 0.9 12.5 -3 900\nFixedParameters: 1 2 3 0\n#Transform 2\nTransform: \
                     VersorRigid3DTransform_double_3_3\nParameters: 0 0 0.19866933079506122 1 2 3\nFixedParameters: 9 8 7\n\
                     #Transform 3\nTransform: TranslationTransform_double_3_3\nParameters: 5 6 7\nFixedParameters: \n";
        let itk = |text: &str| read(&format!("{ITK_MARK} V1.0\n#Transform 0\n{text}")).unwrap();
        let three = itk(whole);
        // Where SimpleITK takes the origin.
        let back = three.isometry.inverse() * Point3::origin();
        assert!((back - Point3::new(14.774368777871182, 3.838670702528087, 912.0702366611649)).norm() < 1e-9, "{back}");
        assert!(three.notes.iter().any(|note| note.starts_with("a composite of 3 transforms")), "{:?}", three.notes);
        let (one, _) = whole.split_once("#Transform 2").unwrap();
        let (_, alone) = one.split_once("#Transform 1\n").unwrap();
        assert_eq!(itk(one).isometry, itk(alone).isometry);
        let identity = itk("Transform: IdentityTransform_double_3_3\nParameters: \nFixedParameters: \n");
        assert_is(&identity.isometry, &Isometry3::identity(), 0.0);
    }

    #[test]
    fn one_motion_is_read_from_every_way_of_writing_it() {
        let nested = format!("{:?}", osteoflow_geometry::matrix_rows(&motion()));
        let flat = format!("[{}]", rows(", ").replace('\n', ", "));
        for text in [
            rows(" "),
            format!("# moves the scan\n{} // last row\n", rows(", ")),
            format!("% as exported\r\n{}\r\n", rows(";\t").replace('\n', "\r\n")),
            format!("\u{feff}{}", rows("  ")),
            // As numpy prints it.
            format!("[[{}]]", rows(" ").replace('\n', "]\n [")),
            nested.clone(),
            flat.clone(),
            format!("{{\"iterations\": 3, \"T\": {flat}}}"),
            format!("{{\"t_target_source\": {{\"to\": \"ct\", \"matrix\": {nested}}}}}"),
        ] {
            let pose = read(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
            assert_is(&pose.isometry, &motion(), 1e-12);
            assert!(pose.notes.is_empty(), "{:?}\n{text}", pose.notes);
        }
    }

    #[test]
    fn translations_may_be_in_metres() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "1 0 0 0.0125\n0 1 0 -3\n0 0 1 0\n0 0 0 1\n").unwrap();
        let pose = read_pose(file.path(), 1000.0).unwrap().isometry;
        assert_eq!(pose.translation.vector, Vector3::new(12.5, -3000.0, 0.0));
    }

    #[test]
    fn a_rounded_matrix_gives_the_nearest_rotation_and_a_note() {
        let text: Vec<_> = motion().to_homogeneous().transpose().iter().map(|c| format!("{c:.4}")).collect();
        let pose = read(&text.join(" ")).unwrap();
        assert_is(&pose.isometry, &motion(), 2e-4);
        let r = pose.isometry.rotation.to_rotation_matrix().into_inner();
        assert!((r.transpose() * r - Matrix3::identity()).amax() < 1e-14);
        assert_eq!(pose.notes.len(), 1, "{:?}", pose.notes);
        let note = &pose.notes[0];
        assert!(
            note.starts_with("the rotation is rounded, and the nearest rotation is used; the correction is "),
            "{note}"
        );
        assert!(note.ends_with(" mm at 1 m"), "{note}");
        let single: Vec<_> = motion().to_homogeneous().transpose().iter().map(|c| format!("{:?}", *c as f32)).collect();
        assert_eq!(read(&single.join(" ")).unwrap().notes.len(), 1, "single precision is rounded too");
    }

    #[test]
    fn a_rounded_itk_transform_says_so_as_well() {
        let r = motion().rotation.to_rotation_matrix();
        let numbers: Vec<_> = r.matrix().transpose().iter().map(|c| format!("{c:.4}")).collect();
        let text = format!(
            "#Insight Transform File V1.0\nTransform: AffineTransform_double_3_3\nParameters: {} 5 6 7\nFixedParameters: 0 0 0\n",
            numbers.join(" ")
        );
        let notes = read(&text).unwrap().notes;
        assert!(notes.len() == 2 && notes[1].starts_with("the rotation is rounded"), "{notes:?}");
        let versor = |i: &str| {
            format!(
                "#Insight Transform File V1.0\nTransform: VersorRigid3DTransform_double_3_3\nParameters: {i} 0 0 1 2 3\n"
            )
        };
        let notes = read(&versor("1.0002")).unwrap().notes;
        assert!(notes.len() == 2 && notes[1].contains("2.0e-4, 0.80 mm at 1 m"), "{notes:?}");
        assert!(
            error_message(&versor("1.0011")).starts_with("Parameters: the quaternion has length 1.0011"),
            "{}",
            error_message(&versor("1.0011"))
        );
    }

    #[test]
    fn an_itk_transform_is_the_inverse_of_what_it_holds_and_turns_about_its_centre() {
        let r = motion().rotation.to_rotation_matrix();
        let parameters: Vec<_> =
            r.matrix().transpose().iter().chain(&[5.0, 6.0, 7.0]).map(|c| format!("{c:?}")).collect();
        let head = "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\nParameters: ";
        let text = format!("{head}{}\nFixedParameters: 10 20 30\n", parameters.join(" "));
        let pose = read(&text).unwrap();
        // The centre of the turn is only shifted.
        let centre = Point3::new(10.0, 20.0, 30.0);
        let moved = centre + Vector3::new(5.0, 6.0, 7.0);
        assert!((pose.isometry * moved - centre).norm() < 1e-12, "{}", pose.isometry);
        assert!(pose.isometry.rotation.angle_to(&motion().rotation.inverse()) < 1e-12);
        assert_eq!(pose.notes, ["an ITK transform leads from fixed to moving; its inverse is taken"]);
    }

    #[test]
    fn rotations_by_angles_and_by_a_versor_are_read_too() {
        let head = "#Insight Transform File V1.0\nTransform: ";
        let quarter = std::f64::consts::FRAC_PI_2;
        let euler = |order: &str| {
            let text = format!(
                "{head}Euler3DTransform_double_3_3\nParameters: {quarter} {quarter} 0 1 2 3\nFixedParameters: 0 0 0{order}\n"
            );
            read(&text).unwrap().isometry.inverse()
        };
        // About y first, then x: z goes to x and stays there. With the fourth fixed parameter x comes first.
        assert!((euler("") * Point3::new(0.0, 0.0, 1.0) - Point3::new(2.0, 2.0, 3.0)).norm() < 1e-12);
        assert!((euler(" 1") * Point3::new(0.0, 0.0, 1.0) - Point3::new(1.0, 1.0, 3.0)).norm() < 1e-12);
        let half = (quarter / 2.0).sin();
        let text =
            format!("{head}VersorRigid3DTransform_double_3_3\nParameters: 0 0 {half} 1 2 3\nFixedParameters: 0 0 0\n");
        let pose = read(&text).unwrap().isometry.inverse();
        assert!((pose * Point3::new(1.0, 0.0, 0.0) - Point3::new(1.0, 3.0, 3.0)).norm() < 1e-12);
    }

    #[test]
    fn what_is_no_rigid_motion_says_why() {
        let itk = |rest: &str| format!("#Insight Transform File V1.0\n{rest}\n");
        for (text, expected) in [
            (
                "1 0 0 0 0 1 0 0 0 0 1 0".into(),
                "matrix: 16 numbers are expected, a 4 x 4 matrix row by row, but there are 12",
            ),
            (String::new(), "byte 0: the file is empty; was it written to the end?"),
            ("1 0 0 0\n0 one 0 0".into(), "line 2: \"one\" is not a number"),
            (
                "1 0 0 0 0 1 0 0 0 0 1 0 5 6 7 1".into(),
                "matrix: the last row of a rigid motion is 0 0 0 1; is the matrix written column by column?",
            ),
            (
                "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1".into(),
                "matrix: the upper left 3 x 3 is not a rotation: it is off by 1.0e0 where 1e-3 is allowed, and its columns have \
                 lengths 2.0000, 2.0000, 2.0000; is there a scale in it?",
            ),
            (
                "1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1".into(),
                "matrix: the matrix is a mirror image (determinant -1.000); are two axes swapped, or is it RAS where LPS is \
                 meant?",
            ),
            ("1 0 0 nan 0 1 0 0 0 0 1 0 0 0 0 1".into(), "matrix: the matrix is not finite"),
            ("{\"pose\": 1}".into(), "object: none of the keys T, t_target_source, matrix is there; there are: pose"),
            ("{\"T\": [1, 2".into(), "line 1: no JSON: EOF while parsing a list at line 1 column 11"),
            ("{\"T\": [[1, 0], [0, 1]]}".into(), "row 1: a row of a 4 x 4 matrix has four numbers"),
            (
                "{\"T\": \"identity\"}".into(),
                "matrix: 16 numbers are expected, a 4 x 4 matrix row by row, but there are 0",
            ),
            (
                itk("Transform: BSplineTransform_double_3_3\nParameters: 1"),
                "Transform: \"BSplineTransform_double_3_3\" is no rigid transform in 3D; save a linear one",
            ),
            (
                itk("Transform: AffineTransform_double_3_3\nParameters: 1 0 0"),
                "Parameters: 12 numbers are expected, but there are 3",
            ),
            (
                itk("Transform: CompositeTransform_double_3_3"),
                "Transform: a composite whose last part is not complete; was the file cut short?",
            ),
            (
                itk(
                    "Transform: CompositeTransform_double_3_3\nTransform: TranslationTransform_double_3_3\nParameters: 1 2 3",
                ),
                "Transform: a composite whose last part is not complete; was the file cut short?",
            ),
            (
                itk("Transform: IdentityTransform_double_3_3\nTransform: IdentityTransform_double_3_3\n"),
                "Transform: several transforms that are no composite; harden them into one linear transform and save that",
            ),
            (itk(""), "header: there is no line \"Transform:\"; was the file cut short?"),
        ] {
            assert_eq!(error_message(&text), expected, "{text}");
        }
        let missing = read_pose("no/such.txt".as_ref(), 1.0).unwrap_err().to_string();
        assert!(missing.starts_with("no/such.txt: cannot be read:"), "{missing}");
    }
}
