//! Undoing horizontal differencing (predictor 2: TIFF 6.0, section 14) and byte order.

/// Turns differences into samples, in place, for rows of `row_bytes` bytes and `stride` samples a pixel.
pub fn undo_u8(bytes: &mut [u8], row_bytes: usize, stride: usize) {
    for row in bytes.chunks_exact_mut(row_bytes) {
        undo_row_u8_scalar(row, stride);
    }
}

/// One row, sample by sample.
pub fn undo_row_u8_scalar(row: &mut [u8], stride: usize) {
    for i in stride..row.len() {
        row[i] = row[i].wrapping_add(row[i - stride]);
    }
}

/// 16-bit samples from the file's bytes: byte order, and differences when `predictor` says so.
pub fn words(bytes: &[u8], out: &mut [u16], big_endian: bool, predictor: Option<usize>) {
    let read = |pair: &[u8]| {
        let pair = [pair[0], pair[1]];
        if big_endian { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) }
    };
    for (word, pair) in out.iter_mut().zip(bytes.chunks_exact(2)) {
        *word = read(pair);
    }
    if let Some(stride) = predictor {
        for i in stride..out.len() {
            out[i] = out[i].wrapping_add(out[i - stride]);
        }
    }
}
