//! Any bytes as an E57 file; its pages get the checksums without which none of it would be read.
#![no_main]

mod common;

use libfuzzer_sys::fuzz_target;

/// CRC-32C, bit by bit.
fn checksum(bytes: &[u8]) -> u32 {
    let step = |value: u32| if value & 1 == 1 { (value >> 1) ^ 0x82f6_3b78 } else { value >> 1 };
    !bytes.iter().fold(!0, |value, &byte| (0..8).fold(value ^ u32::from(byte), |value, _| step(value)))
}

fuzz_target!(|data: &[u8]| {
    let mut file = Vec::new();
    for content in data.chunks(1020) {
        let mut page = content.to_vec();
        page.resize(1020, 0);
        let end = checksum(&page).to_be_bytes();
        file.extend(page);
        file.extend(end);
    }
    common::cloud(&file, ".e57");
});
