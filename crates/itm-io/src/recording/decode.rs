//! From image files to images in memory.

use std::fs;
use std::io::{BufRead, BufReader, Cursor, Read, Seek};
use std::path::Path;

use image::codecs::pnm::{PnmDecoder, PnmHeader, SampleEncoding};
use image::{ColorType, DynamicImage, ExtendedColorType, ImageDecoder, ImageFormat, ImageReader};
use itm_core::{ColourImage, Image};

use crate::Error;

/// What an image is meant to show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    Depth,
    Colour,
}

impl Kind {
    fn check(self, path: &Path, decoder: &impl ImageDecoder) -> Result<(), Error> {
        let colour = decoder.color_type();
        let (fits, expected) = match self {
            Self::Depth => (colour == ColorType::L16, "16-bit greyscale depth"),
            Self::Colour => (
                matches!(colour, ColorType::L8 | ColorType::La8 | ColorType::Rgb8 | ColorType::Rgba8),
                "8-bit colour or greyscale",
            ),
        };
        if fits {
            return Ok(());
        }
        let found = describe(decoder.original_color_type());
        Err(Error::PixelFormat { path: path.to_path_buf(), expected, found })
    }
}

fn describe(colour: ExtendedColorType) -> String {
    let kind = match colour.channel_count() {
        1 => "greyscale",
        2 => "greyscale and alpha",
        3 => "colour",
        _ => "colour and alpha",
    };
    format!("{}-bit {kind}", colour.bits_per_pixel() / u16::from(colour.channel_count().max(1)))
}

/// Reads an image file's header: its kind of pixels and its size.
fn header(path: &Path) -> Result<(ImageReader<impl BufRead + Seek>, ImageFormat), Error> {
    let file = fs::File::open(path).map_err(|reason| Error::io("open", path, reason))?;
    reader(path, BufReader::new(file))
}

fn reader<R: BufRead + Seek>(path: &Path, source: R) -> Result<(ImageReader<R>, ImageFormat), Error> {
    // By content, not by name: names lie.
    let reader = ImageReader::new(source).with_guessed_format().map_err(|reason| Error::io("read", path, reason))?;
    let format = reader.format().ok_or_else(|| undecodable(path, "not a PNG, JPEG, PGM or PPM image"))?;
    Ok((reader, format))
}

fn undecodable(path: &Path, reason: impl ToString) -> Error {
    Error::Decode { path: path.to_path_buf(), reason: reason.to_string() }
}

fn check_size(path: &Path, expected: (u32, u32), found: (u32, u32)) -> Result<(), Error> {
    if found == expected { Ok(()) } else { Err(Error::ImageSize { path: path.to_path_buf(), expected, found }) }
}

/// The size of the first image whose header says that it can be used, or why the first one cannot where none can.
/// One bad image is no reason to refuse a recording.
///
/// # Panics
/// If there are no images at all: a listing without frames is an error before.
pub(super) fn find_usable<'a>(
    kind: Kind,
    images: impl Iterator<Item = &'a Path>,
    expected_size: Option<(u32, u32)>,
) -> Result<(u32, u32), Error> {
    let mut first_error = None;
    for path in images {
        match usable_size(kind, path, expected_size) {
            Ok(size) => return Ok(size),
            Err(error) => first_error = first_error.or(Some(error)),
        }
    }
    Err(first_error.expect("a listing has at least one frame"))
}

fn usable_size(kind: Kind, path: &Path, expected: Option<(u32, u32)>) -> Result<(u32, u32), Error> {
    let decoder = header(path)?.0.into_decoder().map_err(|e| undecodable(path, e))?;
    kind.check(path, &decoder)?;
    let (width, height) = decoder.dimensions();
    check_size(path, expected.unwrap_or((width, height)), (width, height))?;
    if !(1..=16384).contains(&width) || !(1..=16384).contains(&height) {
        return Err(undecodable(path, format!("{width}x{height} pixels are too few or too many")));
    }
    Ok((width, height))
}

/// Whether an image file could be a depth image: greyscale with 16 bits.
pub(super) fn is_depth(path: &Path) -> Result<bool, Error> {
    let decoder = header(path)?.0.into_decoder().map_err(|e| undecodable(path, e))?;
    Ok(decoder.color_type() == ColorType::L16)
}

/// Whether an image file in memory is greyscale with 16 bits, and its size; the reason where it is no image.
pub(super) fn grey_16_bit(bytes: &[u8]) -> Result<(bool, (u32, u32)), String> {
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    let decoder = reader.into_decoder().map_err(|e| e.to_string())?;
    Ok((decoder.color_type() == ColorType::L16, decoder.dimensions()))
}

/// Raw depth values from a 16-bit greyscale PNG or PGM.
pub(super) fn depth(path: &Path, size: (u32, u32)) -> Result<Image<u16>, Error> {
    let bytes = fs::read(path).map_err(|reason| Error::io("open", path, reason))?;
    depth_of(path, &bytes, size)
}

/// The same of a file's bytes; the path is only for errors.
pub(super) fn depth_of(path: &Path, bytes: &[u8], size: (u32, u32)) -> Result<Image<u16>, Error> {
    let (reader, format) = reader(path, Cursor::new(bytes))?;
    let values = if format == ImageFormat::Pnm {
        let decoder = PnmDecoder::new(Cursor::new(bytes)).map_err(|e| undecodable(path, e))?;
        Kind::Depth.check(path, &decoder)?;
        check_size(path, size, decoder.dimensions())?;
        pgm_values(path, decoder)?
    } else {
        let decoder = reader.into_decoder().map_err(|e| undecodable(path, e))?;
        Kind::Depth.check(path, &decoder)?;
        check_size(path, size, decoder.dimensions())?;
        DynamicImage::from_decoder(decoder).map_err(|e| undecodable(path, e))?.into_luma16().into_raw()
    };
    Image::new(size.0, size.1, values).map_err(|e| undecodable(path, e))
}

/// The values of a PGM as they stand in the file. The image crate stretches values to 16 bits where the header's
/// largest one is less than 65535, but a depth of 1000 must stay 1000.
fn pgm_values(path: &Path, decoder: PnmDecoder<Cursor<&[u8]>>) -> Result<Vec<u16>, Error> {
    let (width, height) = decoder.dimensions();
    let count = width as usize * height as usize;
    let (mut rest, header) = decoder.into_inner();
    let values: Vec<u16> = match encoding(&header) {
        SampleEncoding::Binary => {
            let mut bytes = Vec::with_capacity(2 * count);
            rest.by_ref().take(2 * count as u64).read_to_end(&mut bytes).map_err(|e| Error::io("read", path, e))?;
            bytes.as_chunks::<2>().0.iter().map(|&pair| u16::from_be_bytes(pair)).collect()
        }
        SampleEncoding::Ascii => {
            let mut text = String::new();
            rest.read_to_string(&mut text).map_err(|e| undecodable(path, e))?;
            text.split_ascii_whitespace().take(count).map_while(|word| word.parse().ok()).collect()
        }
    };
    if values.len() == count {
        Ok(values)
    } else {
        Err(undecodable(path, format!("it is cut off: {width}x{height} pixels, but only {} values", values.len())))
    }
}

fn encoding(header: &PnmHeader) -> SampleEncoding {
    header.subtype().sample_encoding()
}

/// Colours from any 8-bit image.
pub(super) fn colour(path: &Path, size: (u32, u32)) -> Result<ColourImage, Error> {
    let bytes = fs::read(path).map_err(|reason| Error::io("open", path, reason))?;
    colour_of(path, &bytes, size)
}

/// The same of a file's bytes; the path is only for errors.
pub(super) fn colour_of(path: &Path, bytes: &[u8], size: (u32, u32)) -> Result<ColourImage, Error> {
    let (reader, format) = reader(path, Cursor::new(bytes))?;
    // The JPEG decoder fills what is missing with grey. Within an image 0xff is always followed by something else than
    // the end marker's 0xd9.
    if format == ImageFormat::Jpeg && !bytes.windows(2).any(|pair| pair == [0xff, 0xd9]) {
        return Err(undecodable(path, "it is cut off: no end marker"));
    }
    let decoder = reader.into_decoder().map_err(|e| undecodable(path, e))?;
    Kind::Colour.check(path, &decoder)?;
    check_size(path, size, decoder.dimensions())?;
    let image = DynamicImage::from_decoder(decoder).map_err(|e| undecodable(path, e))?;
    let pixels = image.into_rgb8().into_raw().as_chunks::<3>().0.iter().map(|&[r, g, b]| [r, g, b, 255]).collect();
    Image::new(size.0, size.1, pixels).map_err(|e| undecodable(path, e))
}
