//! Text files that hold one matrix: its numbers row by row, with any white space between them.

use std::path::Path;

use glam::{DMat3, DMat4, DQuat, DVec3};
use itm_core::Se3;

use crate::{Error, text};

/// Reads a 3x3 rotation matrix.
///
/// # Errors
/// Where the file cannot be read, does not hold 9 finite numbers, or holds a matrix that is more than 2 % away from a
/// rotation; the error names the line.
pub(crate) fn read_rotation(path: &Path) -> Result<DQuat, Error> {
    let expected = "9 finite numbers, a 3x3 rotation matrix";
    let (line, numbers) = read_numbers(path, expected)?;
    let rows: [f64; 9] =
        numbers.as_slice().try_into().map_err(|_| Error::line(path, line, expected, count(&numbers)))?;
    let matrix = DMat4::from_mat3(DMat3::from_cols_array(&rows).transpose());
    let motion = Se3::try_from_matrix(matrix).map_err(|e| Error::line(path, line, expected, e.to_string()))?;
    Ok(motion.rotation)
}

/// Reads a pose: a 4x4 matrix, or its upper three rows.
///
/// # Errors
/// Where the file cannot be read, does not hold 16 or 12 finite numbers, or holds a matrix that is more than 2 % away from
/// a rigid motion; the error names the line.
pub(crate) fn read_pose(path: &Path) -> Result<Se3, Error> {
    let expected = "16 or 12 finite numbers, a 4x4 or 3x4 matrix from camera to world";
    let (line, numbers) = read_numbers(path, expected)?;
    let mut all = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    if ![12, 16].contains(&numbers.len()) {
        return Err(Error::line(path, line, expected, count(&numbers)));
    }
    all[..numbers.len()].copy_from_slice(&numbers);
    let matrix = DMat4::from_cols_array(&all).transpose();
    let last = matrix.row(3);
    if last.truncate().abs_diff_eq(DVec3::ZERO, 1e-6) && (last.w - 1.0).abs() <= 1e-6 {
        Se3::try_from_matrix(matrix).map_err(|e| Error::line(path, line, expected, e.to_string()))
    } else {
        let found = format!("{} {} {} {}", last.x, last.y, last.z, last.w);
        Err(Error::line(path, line, "0 0 0 1 as a matrix's last row", text::quoted(&found)))
    }
}

fn count(numbers: &[f64]) -> String {
    format!("{} number{}", numbers.len(), if numbers.len() == 1 { "" } else { "s" })
}

/// All of a file's numbers, each finite, and the line of the first.
fn read_numbers(path: &Path, expected: &str) -> Result<(usize, Vec<f64>), Error> {
    let text = text::read(path)?;
    let first_line = text::data_lines(&text).next().map_or(1, |(line, _)| line);
    let mut numbers = Vec::new();
    for (line, row) in text::data_lines(&text) {
        for word in row.split_whitespace() {
            let number = word.parse().ok().filter(|v: &f64| v.is_finite());
            numbers.push(number.ok_or_else(|| Error::line(path, line, expected, text::quoted(word)))?);
        }
    }
    Ok((first_line, numbers))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn with<T>(text: &str, read: fn(&Path) -> Result<T, Error>) -> Result<T, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.txt");
        std::fs::write(&path, text).unwrap();
        read(&path).map_err(|e| e.to_string())
    }

    proptest! {
        #[test]
        fn matrices_read_back_in_any_layout(
            twist in prop::array::uniform6(-2.0..2.0f64), layout in prop::array::uniform16(prop::bool::ANY), rows in 3..5usize,
        ) {
            let pose = Se3::exp(twist);
            let matrix = pose.to_matrix();
            let breaks = |i: usize| if layout[i % 16] { "\r\n" } else { " \t" };
            let numbers = matrix.transpose().to_cols_array();
            let text: String = (0..4 * rows).map(|i| format!("{}{}", numbers[i], breaks(i))).collect();
            let back = with(&text, read_pose).unwrap();
            prop_assert!(back.to_matrix().abs_diff_eq(matrix, 1e-12));
            let text: String = (0..9).map(|i| format!("{}{}", numbers[i / 3 * 4 + i % 3], breaks(i))).collect();
            let rotation = with(&format!("# sensor to world\n{text}"), read_rotation).unwrap();
            prop_assert!(DMat3::from_quat(rotation).abs_diff_eq(DMat3::from_mat4(matrix), 1e-12));
        }

        #[test]
        fn no_text_makes_it_panic(text in "([-0-9. e#nai]{0,30}\n){0,5}") {
            let _: (Result<_, _>, Result<_, _>) = (with(&text, read_pose), with(&text, read_rotation));
        }
    }

    #[test]
    fn what_is_no_rotation_is_refused_with_its_line() {
        let error = |text| with(text, read_rotation).unwrap_err();
        let few = error("\n1 0 0\n0 1 0\n0 0\n");
        assert!(few.contains("m.txt', line 2: expected 9 finite numbers") && few.ends_with("found 8 numbers"), "{few}");
        assert!(error("1 0 0\n0 1 0\n0 0 nan\n").contains("line 3") && error("").contains("line 1"));
        assert!(error("1 0 0 0 1 0 0 0 one").ends_with("found 'one'"));
        let scaled = error("# by 3 %\n1.03 0 0 0 1.03 0 0 0 1.03");
        assert!(scaled.contains("line 2") && scaled.contains("must be a rotation"), "{scaled}");
        assert!(error("1 0 0 0 1 0 0 0 -1").contains("determinant is -1"), "a mirror is none");
        assert!(with("1.001 0 0 0 1 0 0 0 0.999", read_rotation).unwrap().is_normalized(), "printed with few digits");
    }

    #[test]
    fn what_is_no_pose_is_refused_with_its_line() {
        let error = |text: &str| with(text, read_pose).unwrap_err();
        assert!(error("1 0 0 0\n0 1 0 0\n").ends_with("found 8 numbers"));
        let infinite = error("1 0 0 0\n0 1 0 inf\n0 0 1 0\n0 0 0 1\n");
        assert!(infinite.contains("line 2") && infinite.contains("'inf'"), "{infinite}");
        assert!(error("2 0 0 0\n0 1 0 0\n0 0 1 0\n").contains("must be a rotation"));
        let last = error("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 2\n");
        assert!(last.contains("expected 0 0 0 1") && last.contains("'0 0 0 2'"), "{last}");
    }
}
