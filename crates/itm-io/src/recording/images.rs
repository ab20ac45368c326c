//! Image folders: files that match a pattern, with a calibration file.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::{Folder, FrameFiles, Listing, OpenOptions, nominal_timestamp};
use crate::Error;

/// Where depth images are looked for without a pattern, in this order.
const DEPTH_PATTERNS: [&str; 8] =
    ["depth/*.png", "depth/*.pgm", "depth*.png", "depth*.pgm", "*depth.png", "*depth.pgm", "Frames/*.pgm", "*.pgm"];
/// Where colour images are looked for, likewise.
const COLOUR_NAMES: [&str; 3] = ["rgb", "color", "colour"];
const COLOUR_EXTENSIONS: [&str; 4] = ["png", "jpg", "jpeg", "ppm"];

/// The name of several files in one folder, with one part that varies.
#[derive(Debug)]
pub(crate) struct Pattern {
    pub(super) given: String,
    pub(crate) folder: PathBuf,
    before: String,
    after: String,
    pub(crate) varying: Varying,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Varying {
    Text,
    /// A number with at least so many digits.
    Number(usize),
}

impl Pattern {
    pub(crate) fn parse(base: &Path, given: &str) -> Result<Self, Error> {
        let invalid = || Error::Pattern {
            pattern: given.into(),
            expected: "one number such as %06d, or one *, in its last part and nowhere else",
        };
        let (folder, name) = given.rsplit_once(['/', std::path::MAIN_SEPARATOR]).unwrap_or(("", given));
        let ((before, after), varying) = match (name.split_once('*'), name.split_once('%')) {
            (Some(parts), None) => (parts, Varying::Text),
            (None, Some((before, format))) => {
                let (digits, after) = format.split_once(['d', 'i', 'u']).ok_or_else(invalid)?;
                let digits = if digits.is_empty() { 0 } else { digits.parse().map_err(|_| invalid())? };
                ((before, after), Varying::Number(digits))
            }
            _ => return Err(invalid()),
        };
        if folder.contains('*') || after.contains(['*', '%']) {
            return Err(invalid());
        }
        // The root of the file system is what is left of "/*.png".
        let folder = if folder.is_empty() && given.starts_with('/') { "/" } else { folder };
        // An absolute pattern's folder replaces the base.
        let folder = base.join(folder);
        Ok(Self { given: given.into(), folder, before: before.into(), after: after.into(), varying })
    }

    /// The varying part of a file's name, if the name matches.
    fn varying_part<'n>(&self, name: &'n str) -> Option<&'n str> {
        let part = name.strip_prefix(&self.before)?.strip_suffix(&self.after)?;
        match self.varying {
            Varying::Text => Some(part),
            Varying::Number(_) => is_number(part).then_some(part),
        }
    }

    /// The file with this as its varying part.
    pub(super) fn path(&self, varying: &str) -> PathBuf {
        self.folder.join(format!("{}{varying}{}", self.before, self.after))
    }

    /// The file that one would expect beside another pattern's file with this varying part.
    pub(crate) fn path_expected(&self, varying: &str) -> PathBuf {
        match self.varying {
            Varying::Number(digits) if is_number(varying) => {
                let digits = digits.max(1);
                self.path(&format!("{:0>digits$}", varying.trim_start_matches('0')))
            }
            _ => self.path(varying),
        }
    }

    /// The files that match, by what varies.
    pub(crate) fn files(&self) -> Result<Files, Error> {
        let folder = Folder::list(&self.folder)?;
        let parts = folder.names.iter().filter_map(|name| self.varying_part(name));
        Ok(parts.map(|part| (Key::new(part), part.to_string())).collect())
    }
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit())
}

/// Varying parts of file names, by what identifies them.
pub(crate) type Files = BTreeMap<Key, String>;

/// What identifies an image: a number, or a text whose numbers are ordered by value, so that `a2` comes before `a10`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Key(String);

impl Key {
    /// What identifies an image by its number.
    pub(super) fn of_number(number: u64) -> Self {
        Self(number.to_string())
    }

    /// The number in a text that has one, as `_0007` of `depth_0007.png`.
    pub(super) fn number(&self) -> Option<Self> {
        let mut numbers = self.0.split(|c: char| !c.is_ascii_digit()).filter(|part| !part.is_empty());
        let number = numbers.next().map(Self::new);
        if numbers.next().is_none() { number } else { None }
    }

    /// The leading zeros of a number do not count: `depth_0007` and `colour_7` belong together.
    fn new(varying: &str) -> Self {
        let significant = if is_number(varying) { varying.trim_start_matches('0') } else { varying };
        Self(if significant.is_empty() && !varying.is_empty() { "0" } else { significant }.into())
    }
}

impl Ord for Key {
    fn cmp(&self, other: &Self) -> Ordering {
        let (mut a, mut b) = (self.0.as_str(), other.0.as_str());
        loop {
            let digits = |s: &str| s.bytes().take_while(u8::is_ascii_digit).count();
            let (na, nb) = (digits(a), digits(b));
            let order = if na > 0 && nb > 0 {
                let (x, y) = (a[..na].trim_start_matches('0'), b[..nb].trim_start_matches('0'));
                (a, b) = (&a[na..], &b[nb..]);
                x.len().cmp(&y.len()).then_with(|| x.cmp(y))
            } else {
                let (mut ca, mut cb) = (a.chars(), b.chars());
                let (x, y) = (ca.next(), cb.next());
                if x.is_none() && y.is_none() {
                    // Equal but for leading zeros.
                    return self.0.cmp(&other.0);
                }
                (a, b) = (ca.as_str(), cb.as_str());
                x.cmp(&y)
            };
            if order != Ordering::Equal {
                return order;
            }
        }
    }
}

impl PartialOrd for Key {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

pub(super) fn list(folder: &Folder, options: &OpenOptions) -> Result<Listing, Error> {
    let (depth_pattern, depth) = depth_files(folder, options.depth_pattern.as_deref())?;
    let colour = colour_files(folder, options.colour_pattern.as_deref(), &depth)?;
    if let Some((pattern, colour)) = &colour {
        let alone = colour.keys().filter(|key| !depth.contains_key(key)).count();
        if alone > 0 {
            tracing::warn!("{alone} of {} colour images '{}' have no depth image", colour.len(), pattern.given);
        }
    }
    let frames = (0..)
        .zip(&depth)
        .map(|(position, (key, varying))| FrameFiles {
            // A colour image that is missing is that frame's error.
            colour: colour.as_ref().map(|(pattern, files)| match files.get(key) {
                Some(varying) => pattern.path(varying),
                None => pattern.path_expected(varying),
            }),
            ..FrameFiles::new(depth_pattern.path(varying), nominal_timestamp(position), key.clone())
        })
        .collect();
    Ok(Listing {
        folder: folder.clone(),
        frames,
        preset: None,
        depth_without_colour: 0,
        has_timestamps: false,
        has_gyroscope: false,
        ground_truth: None,
    })
}

fn depth_files(folder: &Folder, pattern: Option<&str>) -> Result<(Pattern, Files), Error> {
    let no_frames = |expected| Error::NoFrames { path: folder.path.clone(), expected };
    if let Some(given) = pattern {
        let pattern = Pattern::parse(&folder.path, given)?;
        let files = pattern.files()?;
        let missing = || no_frames(format!("depth images named as '{given}'"));
        return if files.is_empty() { Err(missing()) } else { Ok((pattern, files)) };
    }
    for pattern in DEPTH_PATTERNS {
        if let Some(found) = files_if_any(folder, pattern)? {
            return Ok(found);
        }
    }
    Err(no_frames(format!("depth images named as one of {}, or a pattern for them", DEPTH_PATTERNS.join(", "))))
}

/// The colour images and the pattern that they match, or `None` where there are none.
fn colour_files(folder: &Folder, pattern: Option<&str>, depth: &Files) -> Result<Option<(Pattern, Files)>, Error> {
    let has_pair = |files: &Files| files.keys().any(|key| depth.contains_key(key));
    if let Some(given) = pattern {
        let pattern = Pattern::parse(&folder.path, given)?;
        let files = pattern.files()?;
        if has_pair(&files) {
            return Ok(Some((pattern, files)));
        }
        let found = files.len();
        let expected =
            format!("colour images named as '{given}' with the depth images' numbers ({found} with other numbers)");
        return Err(Error::NoFrames { path: folder.path.clone(), expected });
    }
    let in_or_beside = |name: &str, extension: &str| {
        [format!("{name}/*.{extension}"), format!("{name}*.{extension}"), format!("*{name}.{extension}")]
    };
    let named = COLOUR_EXTENSIONS.iter().flat_map(|e| COLOUR_NAMES.iter().flat_map(move |n| in_or_beside(n, e)));
    for pattern in named.chain(["Frames/*.ppm".into(), "*.ppm".into()]) {
        if let Some(found) = files_if_any(folder, &pattern)?.filter(|(_, files)| has_pair(files)) {
            return Ok(Some(found));
        }
    }
    Ok(None)
}

fn files_if_any(folder: &Folder, pattern: &str) -> Result<Option<(Pattern, Files)>, Error> {
    let pattern = Pattern::parse(&folder.path, pattern)?;
    if !pattern.folder.is_dir() {
        return Ok(None);
    }
    let files = pattern.files()?;
    Ok(if files.is_empty() { None } else { Some((pattern, files)) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pattern(given: &str) -> Pattern {
        Pattern::parse(Path::new("base"), given).unwrap()
    }

    #[test]
    fn a_pattern_matches_its_own_names_only() {
        let numbered = pattern("depth/d_%04d.pgm");
        assert_eq!(numbered.folder, Path::new("base/depth"));
        assert_eq!(numbered.varying_part("d_0012.pgm"), Some("0012"));
        assert_eq!(numbered.varying_part("d_12345.pgm"), Some("12345"));
        for other in ["d_.pgm", "d_x.pgm", "d_0012.png", "0012.pgm"] {
            assert_eq!(numbered.varying_part(other), None, "{other}");
        }
        assert_eq!(numbered.path_expected("0"), Path::new("base/depth/d_0000.pgm"));
        assert_eq!(numbered.path_expected("000012"), Path::new("base/depth/d_0012.pgm"));
        assert_eq!(pattern("%d.pgm").path_expected("000"), Path::new("base/0.pgm"));
        assert_eq!(pattern("*_depth.png").varying_part("a7_depth.png"), Some("a7"));
        assert_eq!(pattern("%i.png").varying_part("7.png"), Some("7"));
        assert_eq!(pattern("/data/*.png").folder, Path::new("/data"));
    }

    #[test]
    fn patterns_that_cannot_be_followed_are_refused() {
        for bad in ["depth.png", "*/depth.png", "*/*.png", "a%d_%d.png", "%06x.png", "*%d.png", "%d/1.png", "%-3d.png"]
        {
            let error = Pattern::parse(Path::new("base"), bad).map(|p| p.given).unwrap_err().to_string();
            assert!(error.starts_with(&format!("the pattern '{bad}' must have one number")), "{error}");
        }
    }

    #[test]
    fn numbers_are_ordered_by_value_and_leading_zeros_do_not_count() {
        let mut keys = ["b1", "a10", "a2", "10", "0009", "a", "a2b", "000"].map(Key::new);
        keys.sort();
        assert_eq!(keys.map(|key| key.0), ["0", "9", "10", "a", "a2", "a2b", "a10", "b1"]);
        assert_eq!(Key::new("0007"), Key::new("7"));
        assert_ne!(Key::new("a07"), Key::new("a7"));
        assert_eq!(Key::new("_007").number(), Some(Key::new("7")));
        assert_eq!(["a", "1_2", ""].map(|text| Key::new(text).number()), [None, None, None]);
    }

    proptest! {
        #[test]
        fn the_order_is_total(a in "[a0-2]{0,6}", b in "[a0-2]{0,6}", c in "[a0-2]{0,6}") {
            let [a, b, c] = [a, b, c].map(|text| Key::new(&text));
            prop_assert_eq!(a.cmp(&b), b.cmp(&a).reverse());
            prop_assert_eq!(a.cmp(&b) == Ordering::Equal, a == b);
            if a <= b && b <= c {
                prop_assert!(a <= c);
            }
        }
    }
}
