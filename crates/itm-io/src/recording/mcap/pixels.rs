//! From images in messages to images in memory.

use std::path::Path;

use itm_core::{ColourImage, DepthImage, Image};

use super::messages::{ImageMessage, Pixels};
use crate::Error;
use crate::recording::decode;

/// What an image's pixels can be taken for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Content {
    Depth,
    Colour,
    /// Neither, and what they are.
    Other(String),
}

/// The first of a topic's images.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    pub(super) content: Content,
    /// As the message says: `16UC1`, `png`.
    pub(super) encoding: String,
    pub(super) size: (u32, u32),
    pub(super) frame: String,
}

/// What ROS's image_transport calls depth that was compressed losslessly.
const COMPRESSED_DEPTH: &str = "compressedDepth";
/// Its header: a number for the format and two parameters of the quantisation of 32FC1.
const DEPTH_HEADER_BYTES: usize = 12;

/// Bytes a pixel of depth takes, if an encoding is one of depth.
fn depth_bytes(encoding: &str) -> Option<usize> {
    match encoding {
        "16UC1" | "mono16" => Some(2),
        "32FC1" => Some(4),
        _ => None,
    }
}

/// Bytes a pixel of colour takes, and where red, green and blue are among them.
fn colour_bytes(encoding: &str) -> Option<(usize, [usize; 3])> {
    Some(match encoding {
        "rgb8" => (3, [0, 1, 2]),
        // Without a name for its channels, 8UC3 is what OpenCV takes it for.
        "bgr8" | "8UC3" => (3, [2, 1, 0]),
        "rgba8" => (4, [0, 1, 2]),
        "bgra8" | "8UC4" => (4, [2, 1, 0]),
        "mono8" | "8UC1" => (1, [0, 0, 0]),
        _ => return None,
    })
}

impl Sample {
    pub(super) fn of(message: &ImageMessage<'_>) -> Result<Self, String> {
        let frame = message.frame.clone();
        match &message.pixels {
            Pixels::Raw { width, height, encoding, .. } => {
                let content = if depth_bytes(encoding).is_some() {
                    Content::Depth
                } else if colour_bytes(encoding).is_some() {
                    Content::Colour
                } else {
                    Content::Other(encoding.clone())
                };
                Ok(Self { content, encoding: encoding.clone(), size: checked((*width, *height))?, frame })
            }
            Pixels::Compressed { format, data } => {
                let is_depth = format.contains(COMPRESSED_DEPTH);
                let encoding = format.clone();
                if format.to_lowercase().contains("rvl") {
                    let content = Content::Other("RVL".into());
                    return Ok(Self { content, encoding, size: (0, 0), frame });
                }
                let file = if is_depth { depth_file(data)? } else { data };
                let (is_16_bit, size) = decode::grey_16_bit(file)?;
                let content = if is_16_bit { Content::Depth } else { Content::Colour };
                Ok(Self { content, encoding, size: checked(size)?, frame })
            }
        }
    }
}

fn checked((width, height): (u32, u32)) -> Result<(u32, u32), String> {
    let possible = 1..=16384;
    if possible.contains(&width) && possible.contains(&height) {
        Ok((width, height))
    } else {
        Err(format!("{width}x{height} pixels are too few or too many"))
    }
}

fn depth_file(data: &[u8]) -> Result<&[u8], String> {
    data.get(DEPTH_HEADER_BYTES..).ok_or_else(|| "the image is cut off".into())
}

/// An image's rows without what fills them up.
fn rows(data: &[u8], (width, height): (u32, u32), step: usize, bytes: usize) -> Result<Vec<&[u8]>, String> {
    let row = width as usize * bytes;
    // Foxglove's messages may leave it out.
    let step = if step == 0 { row } else { step };
    if step < row {
        return Err(format!("rows of {width} pixels need {row} bytes, but the message has {step} for each"));
    }
    (0..height as usize)
        .map(|y| step.checked_mul(y).and_then(|at| data.get(at..)?.get(..row)))
        .collect::<Option<_>>()
        .ok_or_else(|| {
            format!(
                "{width}x{height} pixels need {} bytes, but there are {}",
                step.saturating_mul(height as usize),
                data.len()
            )
        })
}

fn check_size(expected: (u32, u32), found: (u32, u32)) -> Result<(), String> {
    if expected == found {
        return Ok(());
    }
    let ((w, h), (x, y)) = (expected, found);
    Err(format!("expected an image of {w}x{h} pixels as in the calibration, found {x}x{y}"))
}

/// Why an image file in a message cannot be decoded, without the path, which is none of its own.
fn reason(error: Error) -> String {
    match error {
        Error::Decode { reason, .. } => format!("cannot decode the image: {reason}"),
        Error::PixelFormat { expected, found, .. } => format!("expected {expected}, found {found}"),
        Error::ImageSize { expected, found, .. } => {
            check_size(expected, found).err().unwrap_or_else(|| "its size is another".into())
        }
        other => other.to_string(),
    }
}

/// Depth: raw values in millimetres, or metres.
pub(super) fn depth(message: &ImageMessage<'_>, size: (u32, u32)) -> Result<DepthImage, String> {
    match &message.pixels {
        Pixels::Raw { width, height, encoding, big_endian, step, data } => {
            check_size(size, (*width, *height))?;
            let expected = || format!("expected depth as 16UC1, mono16 or 32FC1, found {encoding}");
            let bytes = depth_bytes(encoding).ok_or_else(expected)?;
            let rows = rows(data, size, *step, bytes)?;
            if bytes == 2 {
                let read = if *big_endian { u16::from_be_bytes } else { u16::from_le_bytes };
                let values = rows.iter().flat_map(|row| row.as_chunks::<2>().0).map(|&pair| read(pair)).collect();
                Image::new(size.0, size.1, values).map(DepthImage::Raw).map_err(|e| e.to_string())
            } else {
                let read = if *big_endian { f32::from_be_bytes } else { f32::from_le_bytes };
                let values = rows.iter().flat_map(|row| row.as_chunks::<4>().0).map(|&four| read(four)).collect();
                Image::new(size.0, size.1, values).map(DepthImage::Metres).map_err(|e| e.to_string())
            }
        }
        Pixels::Compressed { format, data } if format.contains(COMPRESSED_DEPTH) => {
            let file = depth_file(data)?;
            let values = decode::depth_of(Path::new(""), file, size).map_err(reason)?;
            if format.trim_start().starts_with("32FC1") {
                let parameter = |at: usize| data.get(at..).and_then(|rest| rest.first_chunk::<4>());
                let (Some(&a), Some(&b)) = (parameter(4), parameter(8)) else { return Err("it is cut off".into()) };
                let (a, b) = (f32::from_le_bytes(a), f32::from_le_bytes(b));
                // Inverse depth in steps: value = a / depth + b, and 0 where there is none.
                let metres = |&value: &u16| if value == 0 { 0.0 } else { a / (f32::from(value) - b) };
                let metres = values.data().iter().map(metres).collect();
                Image::new(size.0, size.1, metres).map(DepthImage::Metres).map_err(|e| e.to_string())
            } else {
                Ok(DepthImage::Raw(values))
            }
        }
        Pixels::Compressed { data, .. } => {
            decode::depth_of(Path::new(""), data, size).map(DepthImage::Raw).map_err(reason)
        }
    }
}

/// Colours.
pub(super) fn colour(message: &ImageMessage<'_>, size: (u32, u32)) -> Result<ColourImage, String> {
    match &message.pixels {
        Pixels::Raw { width, height, encoding, step, data, .. } => {
            check_size(size, (*width, *height))?;
            let expected = || format!("expected 8-bit colour or grey, such as rgb8, found {encoding}");
            let (bytes, [r, g, b]) = colour_bytes(encoding).ok_or_else(expected)?;
            let rows = rows(data, size, *step, bytes)?;
            let pixels = rows.iter().flat_map(|row| row.chunks_exact(bytes)).map(|p| [p[r], p[g], p[b], 255]);
            Image::new(size.0, size.1, pixels.collect()).map_err(|e| e.to_string())
        }
        Pixels::Compressed { data, .. } => decode::colour_of(Path::new(""), data, size).map_err(reason),
    }
}
