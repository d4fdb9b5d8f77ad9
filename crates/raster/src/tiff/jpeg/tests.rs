//! Against libjpeg, which GDAL's driver reads files with: every pixel the same.

use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use proptest::prelude::*;

use super::*;

/// A picture with edges, gradients and noise.
fn picture(width: usize, height: usize, samples: usize) -> Vec<u8> {
    let mut state = (width * 31 + height) as u32;
    let mut pixels = Vec::new();
    for y in 0..height {
        for x in 0..width {
            for s in 0..samples {
                state = state.wrapping_mul(1664525).wrapping_add(1013904223);
                let edge = if (x / 7 + y / 5) % 3 == s { 120 } else { 0 };
                pixels.push((edge + 2 * x + y * (s + 1) + (state >> 27) as usize).min(255) as u8);
            }
        }
    }
    pixels
}

struct Kind {
    width: usize,
    height: usize,
    samples: usize,
    sampling: SamplingFactor,
    quality: u8,
    restart: u16,
}

impl Kind {
    fn encoded(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, self.quality);
        encoder.set_sampling_factor(self.sampling);
        if self.restart > 0 {
            encoder.set_restart_interval(self.restart);
        }
        let colours = if self.samples == 1 { ColorType::Luma } else { ColorType::Rgb };
        let pixels = picture(self.width, self.height, self.samples);
        encoder.encode(&pixels, self.width as u16, self.height as u16, colours).expect("a JPEG");
        bytes
    }

    fn wanted(&self) -> Wanted {
        Wanted { width: self.width, rows: self.height, samples: self.samples, ycbcr: self.samples == 3 }
    }
}

fn kinds() -> Vec<Kind> {
    let samplings = [SamplingFactor::F_1_1, SamplingFactor::F_2_1, SamplingFactor::F_2_2];
    let mut kinds = Vec::new();
    for (width, height) in [(64, 48), (37, 29), (16, 17), (5, 3), (129, 65), (512, 31)] {
        for (quality, restart) in [(50, 0), (90, 3), (100, 1)] {
            kinds.push(Kind { width, height, samples: 1, sampling: samplings[0], quality, restart });
            kinds.extend(samplings.map(|sampling| Kind { width, height, samples: 3, sampling, quality, restart }));
        }
    }
    kinds
}

fn decoded(kernel: Kernel, data: &[u8], wanted: Wanted) -> Result<Vec<u8>, NotDecoded> {
    let mut out = vec![0; wanted.width * wanted.rows * wanted.samples];
    Decoder::new(kernel).decode(None, data, wanted, &mut out).map(|()| out)
}

fn libjpeg(data: &[u8], wanted: Wanted) -> Vec<u8> {
    let file = tempfile::Builder::new().suffix(".jpg").tempfile().expect("a temporary file");
    std::fs::write(file.path(), data).expect("room for a small file");
    let dataset = gdal::Dataset::open(file.path()).expect("GDAL reads JPEG");
    let size = (wanted.width, wanted.rows);
    let bands: Vec<Vec<u8>> = (1..=wanted.samples)
        .map(|b| {
            dataset.rasterband(b).expect("a band").read_as((0, 0), size, size, None).expect("pixels").data().to_vec()
        })
        .collect();
    (0..wanted.width * wanted.rows).flat_map(|i| bands.iter().map(move |band| band[i])).collect()
}

#[test]
fn pixels_are_those_of_libjpeg() {
    for kind in kinds() {
        let (data, wanted) = (kind.encoded(), kind.wanted());
        let expected = libjpeg(&data, wanted);
        for kernel in Kernel::all() {
            let got = decoded(kernel, &data, wanted).expect("a baseline JPEG");
            let first = got.iter().zip(&expected).position(|(a, b)| a != b);
            assert_eq!(first, None, "{kernel:?} {wanted:?} {:?} quality {}", kind.sampling, kind.quality);
        }
    }
}

#[test]
fn fewer_rows_are_the_first_rows() {
    for kind in kinds() {
        let (data, wanted) = (kind.encoded(), kind.wanted());
        let whole = decoded(Kernel::best(), &data, wanted).expect("a baseline JPEG");
        for rows in [1, wanted.rows / 2, wanted.rows - 1].into_iter().filter(|&rows| rows > 0) {
            let part = decoded(Kernel::best(), &data, Wanted { rows, ..wanted }).expect("a baseline JPEG");
            assert!(part == whole[..part.len()], "{rows} of {wanted:?}");
        }
    }
}

#[test]
fn tables_of_the_file_and_of_the_block_go_together() {
    let kind = Kind { width: 40, height: 24, samples: 3, sampling: SamplingFactor::F_2_2, quality: 80, restart: 0 };
    let (data, wanted) = (kind.encoded(), kind.wanted());
    let whole = decoded(Kernel::best(), &data, wanted).expect("a baseline JPEG");
    // Take the tables out of the block.
    let (mut tables, mut block) = (vec![0xFF, 0xD8], vec![0xFF, 0xD8]);
    let mut at = 2;
    loop {
        let length = usize::from(u16::from_be_bytes([data[at + 2], data[at + 3]])) + 2;
        let to = if matches!(data[at + 1], 0xDB | 0xC4) { &mut tables } else { &mut block };
        to.extend_from_slice(&data[at..at + length]);
        at += length;
        if data[at - length + 1] == 0xDA {
            break;
        }
    }
    block.extend_from_slice(&data[at..]);
    tables.extend([0xFF, 0xD9]);
    let mut out = vec![0; whole.len()];
    let mut decoder = Decoder::new(Kernel::best());
    assert_eq!(decoder.decode(Some(&tables), &block, wanted, &mut out), Ok(()));
    assert!(out == whole);
    // Tables of the block before are not those of this one.
    assert_eq!(decoder.decode(None, &block, wanted, &mut out), Err(NotDecoded));
}

#[test]
fn what_is_not_baseline_or_is_cut_off_is_left_to_others() {
    let kind = Kind { width: 40, height: 24, samples: 3, sampling: SamplingFactor::F_2_2, quality: 80, restart: 0 };
    let (data, wanted) = (kind.encoded(), kind.wanted());
    let mut progressive = Vec::new();
    let mut encoder = Encoder::new(&mut progressive, 80);
    encoder.set_progressive(true);
    encoder.encode(&picture(40, 24, 3), 40, 24, ColorType::Rgb).expect("a JPEG");
    assert_eq!(decoded(Kernel::best(), &progressive, wanted), Err(NotDecoded));
    for length in 0..data.len() - 20 {
        assert_eq!(decoded(Kernel::best(), &data[..length], wanted), Err(NotDecoded), "{length} of {}", data.len());
    }
    for colours in [ColorType::Cmyk, ColorType::Ycck] {
        let mut four = Vec::new();
        Encoder::new(&mut four, 80).encode(&picture(40, 24, 4), 40, 24, colours).expect("a JPEG");
        assert_eq!(decoded(Kernel::best(), &four, Wanted { samples: 4, ..wanted }), Err(NotDecoded));
        assert_eq!(decoded(Kernel::best(), &four, wanted), Err(NotDecoded));
    }
    let wider = Wanted { width: 41, ..wanted };
    assert_eq!(decoded(Kernel::best(), &data, wider), Err(NotDecoded));
    assert_eq!(decoded(Kernel::best(), &data, Wanted { samples: 1, ycbcr: false, ..wanted }), Err(NotDecoded));
}

proptest! {
    #[test]
    fn broken_bytes_never_panic_and_kernels_agree_on_them(
        which in 0usize..72, changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
    ) {
        let kind = &kinds()[which];
        let (mut data, wanted) = (kind.encoded(), kind.wanted());
        for (at, byte) in changes {
            let at = at.index(data.len());
            data[at] = byte;
        }
        let reference = decoded(Kernel::Scalar, &data, wanted);
        for kernel in Kernel::all() {
            prop_assert_eq!(&decoded(kernel, &data, wanted), &reference);
        }
    }
}
