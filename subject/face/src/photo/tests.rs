use std::io::Cursor;

use image::{DynamicImage, ImageFormat, RgbImage};

use super::{Colour, Jpeg, Note, Photo, PhotoError};

/// Pixels without a simple relation between luma and hue.
fn colourful(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        image::Rgb([(x * 5 % 200) as u8 + 20, (y * 7 % 200) as u8 + 20, ((x + y) * 3 % 200) as u8])
    })
}

fn encoded(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

#[test]
fn lossless_formats_give_their_pixels() {
    let picture = colourful(48, 40);
    for format in [ImageFormat::Png, ImageFormat::Pnm] {
        let photo = Photo::from_bytes(&encoded(&picture.clone().into(), format)).unwrap();
        assert_eq!((photo.width(), photo.height()), (48, 40));
        assert_eq!(photo.rgb(7, 31), picture.get_pixel(7, 31).0);
        assert_eq!(photo.colour, Colour::Natural);
        assert!(photo.notes.is_empty(), "{:?}", photo.notes);
        assert_ne!(photo.sha256, [0; 32]);
    }
}

#[test]
fn every_truncation_is_an_error() {
    let picture: DynamicImage = colourful(40, 36).into();
    for format in [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::Pnm] {
        let bytes = encoded(&picture, format);
        Photo::from_bytes(&bytes).unwrap();
        // PNG's end chunk carries no data: decoders do not need its 12 bytes.
        let end = bytes.len() - if format == ImageFormat::Png { 12 } else { 0 };
        for cut in 0..end {
            assert!(Photo::from_bytes(&bytes[..cut]).is_err(), "{format:?} cut at {cut}");
        }
    }
}

#[test]
fn changed_bytes_never_panic() {
    let picture: DynamicImage = colourful(36, 33).into();
    for format in [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::Pnm] {
        let bytes = encoded(&picture, format);
        for at in 0..bytes.len().min(700) {
            for change in [0x01, 0x80, 0xff] {
                let mut changed = bytes.clone();
                changed[at] ^= change;
                if let Ok(photo) = Photo::from_bytes(&changed) {
                    assert_eq!(photo.pixels().len(), photo.width() * photo.height());
                }
            }
        }
    }
}

#[test]
fn exif_orientation_turns_the_picture() {
    let bytes = encoded(&colourful(64, 40).into(), ImageFormat::Jpeg);
    // Big-endian TIFF, one entry: tag 0x0112, SHORT, one value, 6 (turn by 90 degrees clockwise).
    let tiff = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
    let mut turned = bytes[..2].to_vec();
    turned.extend([0xff, 0xe1]);
    turned.extend((tiff.len() as u16 + 2).to_be_bytes());
    turned.extend(tiff);
    turned.extend(&bytes[2..]);
    let (upright, turned) =
        (Photo::from_bytes(&bytes).unwrap(), Photo::from_bytes(&turned).unwrap());
    assert_eq!((turned.width(), turned.height()), (40, 64));
    assert_eq!(turned.notes, [Note::Turned]);
    // The top left corner comes to the top right.
    assert_eq!(turned.rgb(39, 0), upright.rgb(0, 0));
}

#[test]
fn sixteen_bits_and_transparency_get_a_note() {
    let mut rgba = DynamicImage::from(colourful(40, 40)).into_rgba16();
    rgba.get_pixel_mut(3, 4).0[3] = 0;
    let photo = Photo::from_bytes(&encoded(&rgba.into(), ImageFormat::Png)).unwrap();
    assert_eq!(photo.notes, [Note::Reduced, Note::Transparent]);
    assert_eq!(photo.rgb(3, 4), [128; 3]);
}

#[test]
fn grey_and_sepia_have_no_colours_but_a_cast_does() {
    let grey = DynamicImage::from(colourful(64, 64)).into_luma8();
    let photo = Photo::from_bytes(&encoded(&grey.clone().into(), ImageFormat::Jpeg)).unwrap();
    assert_eq!((photo.colour, photo.notes.as_slice()), (Colour::Grey, [Note::Grey].as_slice()));
    let tinted = |tint: [f32; 3]| -> Vec<[u8; 3]> {
        grey.pixels().map(|pixel| tint.map(|t| (f32::from(pixel.0[0]) * t) as u8)).collect()
    };
    let sepia = Photo::from_pixels(64, 64, tinted([1.0, 0.85, 0.7])).unwrap();
    assert_eq!(sepia.colour, Colour::Grey);
    let lamp = colourful(64, 64).pixels().map(|p| [p.0[0], p.0[1], p.0[2] / 4]).collect();
    assert_eq!(Photo::from_pixels(64, 64, lamp).unwrap().colour, Colour::Cast);
}

#[test]
fn sizes_are_bounded_before_anything_is_allocated() {
    let header = |text: &str| Photo::from_bytes(text.as_bytes()).unwrap_err();
    assert!(matches!(header("P6 8 900 255\n"), PhotoError::Small { .. }));
    assert!(matches!(header("P6 60000 60000 255\n"), PhotoError::Large { .. }));
    assert!(matches!(header("P6 6000 6000 255\n"), PhotoError::Truncated { .. }));
    assert!(matches!(Photo::from_bytes(&[]), Err(PhotoError::Empty)));
    assert!(matches!(header("GIF89a, a picture"), PhotoError::Format { .. }));
    assert!(matches!(header("no picture"), PhotoError::Format { .. }));
    let given = Photo::from_pixels(40, 40, vec![[0; 3]; 7]);
    assert!(matches!(given, Err(PhotoError::Pixels { found: 7, .. })));
}

#[test]
fn an_animation_gets_a_note() {
    let bytes = encoded(&colourful(40, 40).into(), ImageFormat::Png);
    // One frame, played once, after the header: its data are the default picture, which is not a frame without an fcTL
    // chunk.
    let mut chunk = b"acTL\0\0\0\x01\0\0\0\x01".to_vec();
    chunk.extend(crc32(&chunk).to_be_bytes());
    let mut animated = bytes[..33].to_vec();
    animated.extend(8u32.to_be_bytes());
    animated.extend(chunk);
    animated.extend(&bytes[33..]);
    assert_eq!(Photo::from_bytes(&animated).unwrap().notes, [Note::Animated]);
}

/// ISO 3309, as PNG has it.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8)
            .fold(crc ^ u32::from(byte), |c, _| (c >> 1) ^ if c & 1 == 1 { 0xedb8_8320 } else { 0 })
    })
}

#[test]
fn print_colours_are_detected_in_the_frame_header() {
    // A frame of four components, and an end after stuffing and a restart.
    let frame = [0xff, 0xd8, 0xff, 0xc0, 0, 20, 8, 0, 64, 0, 64, 4];
    let mut bytes = frame.to_vec();
    bytes.resize(frame.len() + 12, 0);
    bytes.extend([0xff, 0xda, 0, 2, 1, 2, 0xff, 0x00, 0xff, 0xd0, 3]);
    assert_eq!(Jpeg::of(&bytes), Jpeg { components: 4, whole: false });
    bytes.extend([0xff, 0xd9]);
    assert_eq!(Jpeg::of(&bytes), Jpeg { components: 4, whole: true });
}

/// A size in a header is refused before memory is allocated for it: the files below have a few hundred bytes.
#[test]
fn huge_and_tiny_pictures_are_refused_in_every_format() {
    let bytes = encoded(&colourful(40, 40).into(), ImageFormat::Png);
    let png = |width: u32, height: u32| {
        let mut header = b"IHDR".to_vec();
        header.extend(width.to_be_bytes());
        header.extend(height.to_be_bytes());
        header.extend(&bytes[24..29]);
        header.extend(crc32(&header).to_be_bytes());
        [&bytes[..12], &header, &bytes[33..]].concat()
    };
    let jpeg = |width: u16, height: u16| {
        let mut bytes = encoded(&colourful(40, 40).into(), ImageFormat::Jpeg);
        let frame = bytes.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap();
        bytes[frame + 5..frame + 7].copy_from_slice(&height.to_be_bytes());
        bytes[frame + 7..frame + 9].copy_from_slice(&width.to_be_bytes());
        bytes
    };
    Photo::from_bytes(&png(40, 40)).unwrap();
    for bytes in [png(60_000, 60_000), png(u32::MAX >> 1, 1000), jpeg(65_000, 65_000)] {
        let found = Photo::from_bytes(&bytes);
        // Some decoders have their own limit of allocation.
        let refused = matches!(found, Err(PhotoError::Large { .. } | PhotoError::Damaged { .. }));
        assert!(refused, "{found:?}");
    }
    let found = Photo::from_bytes(&png(4, 4));
    assert!(matches!(found, Err(PhotoError::Small { .. })), "{found:?}");
    assert!(Photo::from_bytes(&jpeg(9, 3000)).is_err());
}

#[test]
fn sixteen_bits_of_grey_are_reduced() {
    let grey = DynamicImage::from(colourful(40, 40)).into_luma16();
    for format in [ImageFormat::Png, ImageFormat::Pnm] {
        let photo = Photo::from_bytes(&encoded(&grey.clone().into(), format)).unwrap();
        assert!(photo.notes.contains(&Note::Reduced), "{format:?} {:?}", photo.notes);
        assert!(photo.notes.contains(&Note::Grey), "{format:?} {:?}", photo.notes);
    }
}
