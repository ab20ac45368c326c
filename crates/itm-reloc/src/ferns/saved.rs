//! Keyframes as bytes.
//!
//! All numbers are little-endian:
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `itmferns` |
//! | 4 | version, 1 |
//! | 4 + n | length in bytes, then the settings that codes depend on: lines `key=value` in UTF-8 |
//! | 4 | the number that the next keyframe gets |
//! | 8 | how many keyframes there are, then for each, by increasing number: |
//! | 4, 2, 8 | number, submap, time stamp in nanoseconds |
//! | 7 x 8 | submap_from_camera: quaternion x y z w, translation x y z in metres, in double precision |
//! | 8 a word | the row of its codes, as a `CodeTable` has it |
//! | 4 | CRC-32 of everything before |

use glam::{DQuat, DVec3};
use itm_core::{RelocaliserImage, Se3, Settings, Timestamp};

use super::codes::CodeTable;
use crate::{Difference, Error, Keyframe};

const MAGIC: &[u8; 8] = b"itmferns";
const VERSION: u32 = 1;

/// What stands before a keyframe's codes, in bytes.
const KEYFRAME_BYTES: usize = 4 + 2 + 8 + 7 * 8;

/// The settings that codes depend on, by full key.
pub(super) fn made_with(settings: &Settings) -> Vec<(&'static str, String)> {
    let (view, relocaliser) = (&settings.view, &settings.relocaliser);
    let mut all = vec![
        ("relocaliser.image", relocaliser.image.name().to_string()),
        ("relocaliser.width", relocaliser.width.to_string()),
        ("relocaliser.height", relocaliser.height.to_string()),
        ("relocaliser.smoothing_px", relocaliser.smoothing_px.to_string()),
        ("relocaliser.ferns", relocaliser.ferns.to_string()),
        ("relocaliser.tests", relocaliser.tests.to_string()),
        ("relocaliser.seed", relocaliser.seed.to_string()),
    ];
    if relocaliser.image != RelocaliserImage::Colour {
        all.push(("view.min_depth_m", view.min_depth_m.to_string()));
        all.push(("view.max_depth_m", view.max_depth_m.to_string()));
    }
    all
}

/// The bytes of keyframes and their codes.
pub(super) fn write(
    made_with: &[(&'static str, String)],
    next_id: u32,
    keyframes: &[Keyframe],
    codes: &CodeTable,
) -> Vec<u8> {
    let settings: String = made_with.iter().map(|(key, value)| format!("{key}={value}\n")).collect();
    let mut bytes = Vec::with_capacity(settings.len() + 64 + keyframes.len() * (KEYFRAME_BYTES + 8 * codes.row_len()));
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend((settings.len() as u32).to_le_bytes());
    bytes.extend(settings.as_bytes());
    bytes.extend(next_id.to_le_bytes());
    bytes.extend((keyframes.len() as u64).to_le_bytes());
    for (keyframe, row) in keyframes.iter().zip(codes.rows()) {
        let pose = keyframe.submap_from_camera;
        bytes.extend(keyframe.id.to_le_bytes());
        bytes.extend(keyframe.submap.to_le_bytes());
        bytes.extend(keyframe.timestamp.0.to_le_bytes());
        bytes.extend(pose.rotation.to_array().iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(pose.translation.to_array().iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(row.iter().flat_map(|word| word.to_le_bytes()));
    }
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    bytes
}

/// The next keyframe's number, the keyframes, and their codes in the table given, which is empty.
pub(super) fn read(
    saved: &[u8],
    made_with: &[(&'static str, String)],
    mut codes: CodeTable,
) -> Result<(u32, Vec<Keyframe>, CodeTable), Error> {
    let mut bytes = Bytes { all: saved, at: 0 };
    if bytes.take(MAGIC.len())? != MAGIC {
        return Err(damaged("they do not begin as keyframes of ferns do"));
    }
    // Before the checksum, which another version may have elsewhere.
    let found = u32::from_le_bytes(bytes.array()?);
    if found != VERSION {
        return Err(Error::Version { expected: VERSION, found });
    }
    let (content, checksum) = saved.split_last_chunk().ok_or_else(|| damaged("they have no checksum"))?;
    if bytes.at > content.len() || crc32fast::hash(content) != u32::from_le_bytes(*checksum) {
        return Err(damaged("the checksum does not match, so they are cut off or were changed"));
    }
    bytes.all = content;

    let length = u32::from_le_bytes(bytes.array()?) as usize;
    compare_settings(bytes.take(length)?, made_with)?;
    let next_id = u32::from_le_bytes(bytes.array()?);
    let count = u64::from_le_bytes(bytes.array()?);
    let size = KEYFRAME_BYTES + 8 * codes.row_len();
    let left = bytes.all.len() - bytes.at;
    // Nothing is allocated for keyframes that are not there.
    if count.checked_mul(size as u64) != Some(left as u64) {
        return Err(damaged(&format!("{count} keyframes of {size} bytes cannot stand in {left} bytes")));
    }
    let mut keyframes: Vec<Keyframe> = Vec::with_capacity(count as usize);
    for _ in 0..count {
        let start = bytes.at;
        let keyframe = bytes.keyframe()?;
        let after_last = keyframes.last().is_none_or(|last| last.id < keyframe.id);
        if !after_last || keyframe.id >= next_id {
            return Err(damaged(&format!("the keyframe at byte {start} has the number {}, out of order", keyframe.id)));
        }
        let row = (0..codes.row_len()).map(|_| bytes.array().map(u64::from_le_bytes)).collect::<Result<Vec<_>, _>>()?;
        if !codes.is_row(&row) {
            return Err(damaged(&format!("the keyframe at byte {start} has codes of more ferns than there are")));
        }
        keyframes.push(keyframe);
        codes.push(&row);
    }
    Ok((next_id, keyframes, codes))
}

/// An error with all of the settings that differ.
fn compare_settings(text: &[u8], made_with: &[(&'static str, String)]) -> Result<(), Error> {
    let unknown = || damaged("the settings that they were made with cannot be read");
    let text = std::str::from_utf8(text).map_err(|_| unknown())?;
    let found = text.lines().map(|line| line.split_once('=')).collect::<Option<Vec<_>>>().ok_or_else(unknown)?;
    let mut differences = Vec::new();
    for (setting, expected) in made_with {
        match found.iter().find(|(key, _)| key == setting) {
            Some((_, found)) if found == expected => {}
            Some((_, found)) => {
                differences.push(Difference { setting, expected: expected.clone(), found: (*found).into() });
            }
            // Those of depths do not count for colours alone.
            None if setting.starts_with("view.") => {}
            None => return Err(unknown()),
        }
    }
    match differences.is_empty() {
        true if found.len() == made_with.len() => Ok(()),
        true => Err(unknown()),
        false => Err(Error::SettingsDiffer { differences }),
    }
}

fn damaged(message: &str) -> Error {
    Error::Damaged { message: message.into() }
}

/// Bytes that are read from the front.
struct Bytes<'a> {
    all: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], Error> {
        let left = &self.all[self.at..];
        let taken = left.get(..count).ok_or_else(|| {
            damaged(&format!("they end after {} bytes, {count} were expected from byte {}", self.all.len(), self.at))
        })?;
        self.at += count;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Error> {
        Ok(self.take(N)?.try_into().expect("N bytes were taken"))
    }

    fn floats<const N: usize>(&mut self) -> Result<[f64; N], Error> {
        let mut floats = [0.0; N];
        for float in &mut floats {
            *float = f64::from_le_bytes(self.array()?);
        }
        Ok(floats)
    }

    fn keyframe(&mut self) -> Result<Keyframe, Error> {
        let id = u32::from_le_bytes(self.array()?);
        let submap = u16::from_le_bytes(self.array()?);
        let timestamp = Timestamp(i64::from_le_bytes(self.array()?));
        let (rotation, translation) = (DQuat::from_array(self.floats()?), DVec3::from_array(self.floats()?));
        Se3::try_from_quaternion(rotation, translation)
            .map_err(|error| damaged(&format!("the pose of keyframe {id}: {error}")))?;
        // As it was saved: normalising it again could change its last digits.
        Ok(Keyframe { id, submap, submap_from_camera: Se3 { rotation, translation }, timestamp })
    }
}
