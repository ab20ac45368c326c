//! Calibration files in the format of the InfiniTAM v3 report (Prisacariu et al. 2017, section 'UI, Usage and
//! Examples').
//!
//! ```text
//! 640 480                                    colour image: width and height in pixels
//! 504.261 503.905                            colour camera: focal lengths fx and fy in pixels
//! 352.457 272.202                            colour camera: principal point cx and cy in pixels
//!
//! 640 480                                    the same of the depth camera
//! 573.71 574.394
//! 346.471 249.031
//!
//! 0.999749 0.00518867 0.0217975 0.0243073    depth coordinates to colour coordinates: three rows of a rotation and a
//! -0.0051649 0.999986 -0.0011465 -0.000166518     translation in metres
//! -0.0218031 0.00103363 0.999762 0.0151706
//!
//! 1135.09 0.0819141                          what raw depth means
//! ```
//!
//! The last line is one of
//! - `a b` or `kinect a b`: disparities, `depth = 8 b fx / (a - raw)` with `fx` of the depth camera;
//! - `affine a b`: `depth = a raw + b` in metres;
//! - `0 0`: millimetres, as `affine 0.001 0`.
//!
//! After it a line for each camera whose lens bends its image may stand, in either order, with the coefficients of
//! [`Distortion`]:
//! - `depth-distortion brown k1 k2 p1 p2 k3` or `colour-distortion brown k1 k2 p1 p2 k3`;
//! - `depth-distortion rational k1 k2 p1 p2 k3 k4 k5 k6`, likewise for colour.
//!
//! Blank lines and lines that start with `#` are passed over. Pixel (0, 0) is the centre of the upper left pixel.

use std::path::Path;

use glam::{DMat4, DVec4};
use itm_core::{Calibration, DepthConversion, Distortion, Intrinsics, Se3};

use crate::{Error, text};

/// Reads a calibration file.
///
/// # Errors
/// Where the file cannot be read, a line has too few or too many values (the error names the line), or the numbers
/// cannot be meant.
pub fn read(path: &Path) -> Result<Calibration, Error> {
    parse(&text::read(path)?, path)
}

/// Reads a calibration from text; `path` is the file to name in errors.
///
/// # Errors
/// As [`read`], without touching a file.
pub fn parse(text: &str, path: &Path) -> Result<Calibration, Error> {
    let mut lines = Lines { path, end: text.lines().count() + 1, lines: text::data_lines(text) };
    let colour = lines.intrinsics(&COLOUR)?;
    let depth = lines.intrinsics(&DEPTH)?;
    let (first_row, row) = lines.numbers::<4>(MOTION)?;
    let rows = [row, lines.numbers::<4>(MOTION)?.1, lines.numbers::<4>(MOTION)?.1, [0.0, 0.0, 0.0, 1.0]];
    let matrix = DMat4::from_cols_array_2d(&rows).transpose();
    let colour_from_depth = Se3::try_from_matrix(matrix)
        .map_err(|e| Error::line(path, first_row, "three rows of a rotation and a translation", e.to_string()))?;
    let depth_conversion = lines.depth_conversion()?;
    let (depth_distortion, colour_distortion) = lines.distortions()?;
    let calibration =
        Calibration { depth, colour, colour_from_depth, depth_conversion, depth_distortion, colour_distortion };
    calibration.validate().map_err(|reason| Error::Calibration { path: path.to_path_buf(), reason })?;
    Ok(calibration)
}

/// The text of a calibration file. Numbers are written with all their digits.
pub fn to_text(calibration: &Calibration) -> String {
    let camera = |i: &Intrinsics| format!("{} {}\n{} {}\n{} {}\n\n", i.width, i.height, i.fx, i.fy, i.cx, i.cy);
    let matrix = calibration.colour_from_depth.to_matrix();
    let row = |r: DVec4| format!("{} {} {} {}\n", r.x, r.y, r.z, r.w);
    let conversion = match calibration.depth_conversion {
        DepthConversion::Affine { scale, offset } => format!("affine {scale} {offset}"),
        DepthConversion::Disparity { a, b } => format!("kinect {a} {b}"),
    };
    let distortion = |name: &str, lens: &Distortion| {
        let (model, coefficients) = match lens {
            Distortion::None => return String::new(),
            Distortion::Brown { .. } => ("brown", &lens.coefficients()[..5]),
            Distortion::Rational { .. } => ("rational", &lens.coefficients()[..]),
        };
        let coefficients: Vec<String> = coefficients.iter().map(f64::to_string).collect();
        format!("{name} {model} {}\n", coefficients.join(" "))
    };
    format!(
        "{}{}{}{}{}\n{conversion}\n{}{}",
        camera(&calibration.colour),
        camera(&calibration.depth),
        row(matrix.row(0)),
        row(matrix.row(1)),
        row(matrix.row(2)),
        distortion(DEPTH_LENS, &calibration.depth_distortion),
        distortion(COLOUR_LENS, &calibration.colour_distortion),
    )
}

/// Writes a calibration file.
///
/// # Errors
/// Where the file cannot be written.
pub fn write(path: &Path, calibration: &Calibration) -> Result<(), Error> {
    std::fs::write(path, to_text(calibration)).map_err(|reason| Error::io("write", path, reason))
}

/// What the three lines about a camera must hold, for errors.
struct CameraLines {
    size: &'static str,
    focal_lengths: &'static str,
    principal_point: &'static str,
}

const COLOUR: CameraLines = CameraLines {
    size: "2 values (width and height of the colour image in pixels)",
    focal_lengths: "2 values (fx and fy of the colour camera)",
    principal_point: "2 values (cx and cy of the colour camera)",
};
const DEPTH: CameraLines = CameraLines {
    size: "2 values (width and height of the depth image in pixels)",
    focal_lengths: "2 values (fx and fy of the depth camera)",
    principal_point: "2 values (cx and cy of the depth camera)",
};
const MOTION: &str = "4 values (a row of the 3x4 matrix from depth to colour coordinates)";
const DEPTH_CONVERSION: &str = "'a b', 'kinect a b' or 'affine a b' (what raw depth means)";
const DEPTH_LENS: &str = "depth-distortion";
const COLOUR_LENS: &str = "colour-distortion";
const DISTORTION: &str = "'depth-distortion' or 'colour-distortion', each at most once, or the end of the file";
const MODEL: &str = "'brown k1 k2 p1 p2 k3' or 'rational k1 k2 p1 p2 k3 k4 k5 k6' after the name";

struct Lines<'a, I> {
    path: &'a Path,
    /// Number of the line after the last.
    end: usize,
    lines: I,
}

impl<'a, I: Iterator<Item = (usize, &'a str)>> Lines<'a, I> {
    fn next(&mut self, expected: &str) -> Result<(usize, &'a str), Error> {
        self.lines.next().ok_or_else(|| Error::line(self.path, self.end, expected, "the end of the file"))
    }

    /// The next line's number and values: exactly `N`.
    fn numbers<const N: usize>(&mut self, expected: &str) -> Result<(usize, [f64; N]), Error> {
        let (line, text) = self.next(expected)?;
        Ok((line, self.parse(line, text, text.split_whitespace(), expected)?))
    }

    fn parse<'w, T: std::str::FromStr + Copy + Default, const N: usize>(
        &self,
        line: usize,
        text: &str,
        words: impl Iterator<Item = &'w str>,
        expected: &str,
    ) -> Result<[T; N], Error> {
        let (mut values, mut count) = ([T::default(); N], 0);
        for word in words {
            let value = word.parse().map_err(|_| {
                Error::line(self.path, line, expected, format!("{} in {}", text::quoted(word), text::quoted(text)))
            })?;
            if let Some(place) = values.get_mut(count) {
                *place = value;
            }
            count += 1;
        }
        if count == N {
            return Ok(values);
        }
        let plural = if count == 1 { "" } else { "s" };
        Err(Error::line(self.path, line, expected, format!("{count} value{plural}: {}", text::quoted(text))))
    }

    fn intrinsics(&mut self, expected: &CameraLines) -> Result<Intrinsics, Error> {
        let (line, text) = self.next(expected.size)?;
        let [width, height] = self.parse(line, text, text.split_whitespace(), expected.size)?;
        let [fx, fy] = self.numbers(expected.focal_lengths)?.1;
        let [cx, cy] = self.numbers(expected.principal_point)?.1;
        Ok(Intrinsics::new(width, height, fx, fy, cx, cy))
    }

    fn depth_conversion(&mut self) -> Result<DepthConversion, Error> {
        let (line, text) = self.next(DEPTH_CONVERSION)?;
        let mut words = text.split_whitespace().peekable();
        let kind = words.next_if(|word| ["kinect", "affine"].contains(word));
        let [a, b] = self.parse(line, text, words, DEPTH_CONVERSION)?;
        Ok(match kind {
            Some("affine") => DepthConversion::Affine { scale: a, offset: b },
            None if a == 0.0 && b == 0.0 => DepthConversion::MILLIMETRES,
            _ => DepthConversion::Disparity { a, b },
        })
    }

    /// The rest of the file: the depth camera's lens and the colour camera's.
    fn distortions(&mut self) -> Result<(Distortion, Distortion), Error> {
        let (mut depth, mut colour) = (None, None);
        while let Some((line, text)) = self.lines.next() {
            let mut words = text.split_whitespace();
            let lens = match words.next() {
                Some(DEPTH_LENS) => &mut depth,
                Some(COLOUR_LENS) => &mut colour,
                _ => return Err(Error::line(self.path, line, DISTORTION, text::quoted(text))),
            };
            if lens.is_some() {
                return Err(Error::line(self.path, line, DISTORTION, format!("a second {}", text::quoted(text))));
            }
            *lens = Some(match words.next() {
                Some("brown") => Distortion::brown(self.parse(line, text, words, MODEL)?),
                Some("rational") => Distortion::rational(self.parse(line, text, words, MODEL)?),
                _ => return Err(Error::line(self.path, line, MODEL, text::quoted(text))),
            });
        }
        Ok((depth.unwrap_or_default(), colour.unwrap_or_default()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    const REPORT: &str = "640 480\n504.261 503.905\n352.457 272.202\n\n640 480\n573.71 574.394\n346.471 249.031\n\n\
        0.999749 0.00518867 0.0217975 0.0243073\n-0.0051649 0.999986 -0.0011465 -0.000166518\n\
        -0.0218031 0.00103363 0.999762 0.0151706\n\n1135.09 0.0819141\n";

    fn parsed(text: &str) -> Result<Calibration, String> {
        parse(text, Path::new("calibration.txt")).map_err(|e| e.to_string())
    }

    #[test]
    fn the_reports_own_example_is_read() {
        let calibration = parsed(REPORT).unwrap();
        assert_eq!(calibration.colour, Intrinsics::new(640, 480, 504.261, 503.905, 352.457, 272.202));
        assert_eq!(calibration.depth, Intrinsics::new(640, 480, 573.71, 574.394, 346.471, 249.031));
        assert_eq!(calibration.depth_conversion, DepthConversion::Disparity { a: 1135.09, b: 0.0819141 });
        let point = calibration.colour_from_depth.transform_point(DVec3::new(0.0, 0.0, 2.0));
        assert!(point.abs_diff_eq(DVec3::new(0.067_902_3, -0.002_459_5, 2.014_694_6), 1e-5), "{point}");
    }

    #[test]
    fn windows_line_ends_tabs_and_comments_do_not_matter() {
        let text = REPORT.replace("\n\n", "\n# next\n").replace('\n', "\r\n").replace(' ', "\t");
        assert_eq!(parsed(&text), parsed(REPORT));
    }

    #[test]
    fn the_last_line_says_what_raw_depth_means() {
        let with = |last: &str| parsed(&REPORT.replace("1135.09 0.0819141", last)).map(|c| c.depth_conversion);
        assert_eq!(with("kinect 1090 0.075"), Ok(DepthConversion::Disparity { a: 1090.0, b: 0.075 }));
        assert_eq!(with("affine 0.0002 0.01"), Ok(DepthConversion::Affine { scale: 0.0002, offset: 0.01 }));
        assert_eq!(with("0 0"), Ok(DepthConversion::MILLIMETRES));
        assert!(with("affine 0 0").unwrap_err().contains("depth conversion"));
        assert!(with("openni 1 2").unwrap_err().contains("'openni'"));
    }

    #[test]
    fn a_wrong_number_of_values_is_named_with_its_line() {
        let error = parsed(&REPORT.replace("504.261 503.905", "504.261")).unwrap_err();
        assert_eq!(
            error,
            "'calibration.txt', line 2: expected 2 values (fx and fy of the colour camera), found 1 value: '504.261'"
        );
        let error = parsed(&REPORT.replace("-0.000166518", "-0.000166518 7")).unwrap_err();
        assert!(
            error.contains("line 10") && error.contains("expected 4 values") && error.contains("found 5"),
            "{error}"
        );
        let error = parsed("640 480\n500 500\n").unwrap_err();
        assert!(error.contains("line 3") && error.ends_with("found the end of the file"), "{error}");
        let error = parsed(&format!("{REPORT}1 2\n")).unwrap_err();
        assert!(error.contains("line 14: expected 'depth-distortion' or 'colour-distortion'"), "{error}");
        assert!(error.ends_with("or the end of the file, found '1 2'"), "{error}");
        let error = parsed(&REPORT.replace("1135.09 0.0819141", "affine 1 2 3")).unwrap_err();
        assert!(error.contains("line 13") && error.contains("found 3 values"), "{error}");
    }

    #[test]
    fn numbers_that_cannot_be_meant_are_refused() {
        let error = parsed(&REPORT.replace("640 480", "640.5 480")).unwrap_err();
        assert!(error.contains("line 1") && error.contains("'640.5'"), "{error}");
        let error = parsed(&REPORT.replace("573.71 ", "0 ")).unwrap_err();
        assert!(error.contains("calibration.txt") && error.contains("depth camera's fx"), "{error}");
        let error = parsed(&REPORT.replace("0.999749 ", "1.3 ")).unwrap_err();
        assert!(error.contains("line 9") && error.contains("rotation"), "{error}");
        let error = parsed(&REPORT.replace("0.0243073", "nan")).unwrap_err();
        assert!(error.contains("line 9") && error.contains("finite"), "{error}");
    }

    #[test]
    fn lenses_may_follow_in_either_order() {
        let with = |rest: &str| parsed(&format!("{REPORT}{rest}"));
        let none = with("").unwrap();
        assert_eq!((none.depth_distortion, none.colour_distortion), (Distortion::None, Distortion::None));
        assert!(to_text(&none).ends_with("kinect 1135.09 0.0819141\n"), "nothing is said where there is no lens");
        let colour = "colour-distortion brown 0.26 -0.95 -0.0054 0.0026 1.16\n";
        let depth = "\n# the infrared camera\ndepth-distortion rational 0.1 0.2 0 1e-4 0 0.1 0.2 0.3\n";
        let both = with(&format!("{colour}{depth}")).unwrap();
        assert_eq!(with(&format!("{depth}{colour}")).unwrap(), both);
        assert_eq!(both.colour_distortion, Distortion::brown([0.26, -0.95, -0.0054, 0.0026, 1.16]));
        assert_eq!(both.depth_distortion, Distortion::rational([0.1, 0.2, 0.0, 1e-4, 0.0, 0.1, 0.2, 0.3]));
        assert_eq!(with(colour).unwrap().depth_distortion, Distortion::None);
    }

    #[test]
    fn lenses_that_are_not_understood_are_refused_with_their_line() {
        let error = |rest: &str| parsed(&format!("{REPORT}{rest}\n")).unwrap_err();
        let few = error("colour-distortion brown 0.1 0.2 0 0");
        assert!(few.contains("line 14: expected 'brown k1 k2 p1 p2 k3'") && few.contains("found 4 values"), "{few}");
        assert!(error("depth-distortion rational 0 0 0 0 0").contains("found 5 values"));
        let model = error("depth-distortion fisheye 0 0 0 0");
        assert!(model.contains("line 14: expected 'brown") && model.ends_with("'depth-distortion fisheye 0 0 0 0'"));
        assert!(error("depth-distortion").contains("expected 'brown"));
        assert!(error("colour-distortion brown 0 0 0 x 0").contains("'x' in"));
        let twice = error("depth-distortion brown 0 0 0 0 0\ndepth-distortion brown 0 0 0 0 0");
        assert!(twice.contains("line 15") && twice.contains("at most once"), "{twice}");
        assert!(error("lens brown 0 0 0 0 0").contains("expected 'depth-distortion' or 'colour-distortion'"));
        let folding = error("colour-distortion brown -3 0 0 0 0");
        assert!(folding.contains("calibration.txt") && folding.contains("colour camera's distortion"), "{folding}");
        assert!(error("depth-distortion brown nan 0 0 0 0").contains("depth camera's distortion"));
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = read(Path::new("/nowhere/calibration.txt")).unwrap_err().to_string();
        assert!(error.starts_with("cannot read '/nowhere/calibration.txt':"), "{error}");
    }

    /// A polynomial that grows, over a denominator that does not.
    fn mild_rational([k1, k2, _, _, k3, ..]: [f64; 8]) -> Distortion {
        Distortion::rational([k1, k2, 0.0, 0.0, k3, 0.0, 0.0, 0.0])
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back(
            f in prop::array::uniform4(1.0..2000.0f64),
            c in prop::array::uniform4(-100.0..2000.0f64),
            twist in prop::array::uniform6(-1.0..1.0f64),
            (width, height) in (1..4000u32, 1..4000u32),
            (a, b, disparity) in (0.0001..2000.0f64, 0.001..1.0f64, any::<bool>()),
            // Cameras here may be very wide, so that only the mildest lenses are sure not to fold.
            k in prop::array::uniform8(0.0..1e-9f64),
            lenses: [bool; 2],
        ) {
            let calibration = Calibration {
                depth: Intrinsics::new(width, height, f[0], -f[1], c[0], c[1]),
                colour: Intrinsics::new(height, width, f[2], f[3], c[2], c[3]),
                colour_from_depth: Se3::exp(twist),
                depth_conversion: if disparity {
                    DepthConversion::Disparity { a, b }
                } else {
                    DepthConversion::Affine { scale: a, offset: b }
                },
                depth_distortion: if lenses[0] { Distortion::brown([k[0], k[1], 0.0, 0.0, k[2]]) } else { Distortion::None },
                colour_distortion: if lenses[1] { mild_rational(k) } else { Distortion::None },
            };
            let back = parsed(&to_text(&calibration)).unwrap();
            let motion = back.colour_from_depth.to_matrix();
            prop_assert!(motion.abs_diff_eq(calibration.colour_from_depth.to_matrix(), 1e-12));
            let rest = Calibration { colour_from_depth: calibration.colour_from_depth, ..back };
            prop_assert_eq!(rest, calibration);
        }

        #[test]
        fn no_text_makes_it_panic(text in "([-0-9. akine#]{0,30}\n){0,16}(depth-distortion [-0-9. brown]{0,20}\n){0,2}") {
            let _: Result<_, _> = parsed(&text);
        }
    }
}
