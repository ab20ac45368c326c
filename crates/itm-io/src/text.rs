//! What the readers of text files share.

use std::path::Path;

use itm_core::Timestamp;

use crate::Error;

/// Reads a whole text file. Bytes that are not UTF-8 become replacement characters, so that they show up in the error
/// about the line they stand in.
pub(crate) fn read(path: &Path) -> Result<String, Error> {
    let bytes = std::fs::read(path).map_err(|reason| Error::io("read", path, reason))?;
    Ok(String::from_utf8(bytes).unwrap_or_else(|e| String::from_utf8_lossy(e.as_bytes()).into_owned()))
}

/// A string as shown in an error: in quotes, and cut where it is long.
pub(crate) fn quoted(text: &str) -> String {
    let mut chars = text.chars();
    let start: String = chars.by_ref().take(60).collect();
    if chars.next().is_some() { format!("'{start}…'") } else { format!("'{start}'") }
}

/// The lines of a text that hold data, with their numbers from 1: neither blank nor comments (`#`), without the spaces
/// around them, a carriage return at the end or a byte order mark at the start of the text.
pub(crate) fn data_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    (1..).zip(text.lines().map(str::trim)).filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// A time stamp from decimal seconds, to the nearest nanosecond: `1305031229.528748`, `-0.5`, `17` or, as numpy
/// prints them, `1.305031229528748e+09`. `None` where the text is no such number or does not fit.
///
/// Does not go through floating point, which would keep only about 0.2 microseconds of times since 1970.
pub(crate) fn parse_seconds(text: &str) -> Option<Timestamp> {
    const NANOSECOND_DIGITS: i32 = 9;
    let (sign, unsigned) = match text.strip_prefix('-') {
        Some(rest) => (-1, rest),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let (mantissa, exponent) = match unsigned.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok().filter(|e| (-99..=99).contains(e))?),
        None => (unsigned, 0),
    };
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let mut digits = whole.bytes().chain(fraction.bytes());
    if mantissa.len() > 99 || digits.clone().next().is_none() || !digits.clone().all(|b| b.is_ascii_digit()) {
        return None;
    }
    // The decimal point's place, counted in digits from the start, once the unit is a nanosecond.
    let point = whole.len() as i32 + exponent + NANOSECOND_DIGITS;
    let mut nanoseconds: i128 = 0;
    for _ in 0..point {
        let digit = digits.next().map_or(0, |b| b - b'0');
        nanoseconds = nanoseconds.checked_mul(10)?.checked_add(digit.into())?;
    }
    if point >= 0 && digits.next().is_some_and(|b| b >= b'5') {
        nanoseconds += 1;
    }
    i64::try_from(sign * nanoseconds).ok().map(Timestamp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn printed_times_read_back_exactly(ns: i64) {
            prop_assert_eq!(parse_seconds(&Timestamp(ns).to_string()), Some(Timestamp(ns)));
        }

        #[test]
        fn any_text_is_read_or_refused(text in "[-+]?[0-9.eE+-]{0,12}") {
            if let Some(Timestamp(ns)) = parse_seconds(&text) {
                let float = text.parse::<f64>().unwrap() * 1e9;
                prop_assert!((ns as f64 - float).abs() <= 0.5 + 1e-6 * float.abs(), "{text}: {ns}");
            }
        }
    }

    #[test]
    fn seconds_are_read_in_all_their_forms() {
        let ns = |text| parse_seconds(text).map(|t| t.0);
        assert_eq!(ns("1305031229.528748"), Some(1_305_031_229_528_748_000));
        assert_eq!(ns("1.305031229528748123e+09"), Some(1_305_031_229_528_748_123));
        assert_eq!(ns("17"), Some(17_000_000_000));
        assert_eq!(ns("-.5"), Some(-500_000_000));
        assert_eq!(ns("+5."), Some(5_000_000_000));
        assert_eq!(ns("0.0000000015"), Some(2));
        assert_eq!(ns("6e-10"), Some(1));
        assert_eq!(ns("9e-11"), Some(0));
        assert_eq!(ns("-9223372036.854775808"), Some(i64::MIN));
        for bad in ["", ".", "-", "1e", "1e400", "nan", "inf", "0x10", "1.2.3", "--1", "1 2", "9223372036.854775808"] {
            assert_eq!(ns(bad), None, "{bad}");
        }
    }

    #[test]
    fn comments_and_blank_lines_keep_their_numbers() {
        let lines: Vec<_> = data_lines("\u{feff}# first\r\n\r\n a b \r\nc\n   # no\nd").collect();
        assert_eq!(lines, [(3, "a b"), (4, "c"), (6, "d")]);
    }
}
