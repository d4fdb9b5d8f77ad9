//! GeoTIFF keys that spell a reference system out: GDAL reads them, from a TIFF of one pixel that holds nothing else.

use std::sync::atomic::{AtomicU64, Ordering};

/// Tags of the keys, their doubles and their texts, with TIFF's type and the bytes of one value.
const TAGS: [(u16, u16, usize); 3] = [(34_735, 3, 2), (34_736, 12, 8), (34_737, 2, 1)];

/// The system of the keys, of their doubles and their texts as WKT; `None` without keys, or where they name none.
pub(super) fn wkt(parts: [Option<&[u8]>; 3]) -> Option<String> {
    /// Files in memory have names that no other reader of this process has.
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let path = format!("/vsimem/geokeys-{}.tif", NUMBER.fetch_add(1, Ordering::Relaxed));
    let [keys, ..] = parts;
    // The fourth number of the head says how many keys follow; some writers fill up with zeros.
    let keys = keys.filter(|keys| keys.len() >= 8)?;
    let count = usize::from(u16::from_le_bytes([keys[6], keys[7]]));
    let keys = known_units(&keys[..(8 * (count + 1)).min(keys.len() / 8 * 8)]);
    gdal::vsi::create_mem_file(&path, one_pixel([Some(&keys), parts[1], parts[2]])).ok()?;
    // Keys that are damaged harm no file that is being written meanwhile.
    let found = autoref_raster::unheard(|| gdal::Dataset::open(&path).map(|dataset| dataset.projection()));
    gdal::vsi::unlink_mem_file(&path).ok()?;
    // A system of its own axes only says that nothing is known.
    found.ok().filter(|wkt| !wkt.is_empty() && !wkt.starts_with("LOCAL_CS") && !wkt.starts_with("ENGCRS"))
}

/// The keys without units whose codes are none of EPSG's, which PROJ would complain of on the terminal.
fn known_units(keys: &[u8]) -> Vec<u8> {
    /// Of geographic and vertical axes, angles and lengths; and the code of a unit that other keys describe.
    const UNITS: [u16; 4] = [2052, 2054, 3076, 4099];
    const DESCRIBED: u16 = 32_767;
    let word = |key: &[u8], at: usize| u16::from_le_bytes([key[at], key[at + 1]]);
    let is_known = |key: &&[u8]| {
        let (id, place, value) = (word(key, 0), word(key, 2), word(key, 6));
        !UNITS.contains(&id) || place != 0 || (9000..10_000).contains(&value) || value == DESCRIBED
    };
    let (head, rest) = keys.split_at(8);
    let kept: Vec<&[u8]> = rest.chunks_exact(8).filter(is_known).collect();
    let mut all = head.to_vec();
    all[6..8].copy_from_slice(&(kept.len() as u16).to_le_bytes());
    all.extend(kept.concat());
    all
}

/// A little-endian TIFF of one byte.
fn one_pixel(parts: [Option<&[u8]>; 3]) -> Vec<u8> {
    // Width, height, bits, compression, colour, place, samples, rows and bytes of the strip.
    let mut entries: Vec<(u16, u16, u32, [u8; 4])> =
        [(256, 1u16), (257, 1), (258, 8), (259, 1), (262, 1), (273, 8), (277, 1), (278, 1), (279, 1)]
            .map(|(tag, value)| (tag, 3, 1, [value.to_le_bytes()[0], value.to_le_bytes()[1], 0, 0]))
            .to_vec();
    let mut file = b"II\x2a\0\0\0\0\0\0\0".to_vec();
    for ((tag, kind, size), bytes) in TAGS.into_iter().zip(parts) {
        let Some(bytes) = bytes.filter(|bytes| bytes.len() >= size) else { continue };
        let whole = &bytes[..bytes.len() / size * size];
        let mut value = [0; 4];
        if whole.len() <= 4 {
            value[..whole.len()].copy_from_slice(whole);
        } else {
            value = (file.len() as u32).to_le_bytes();
            file.extend_from_slice(whole);
            file.resize(file.len().next_multiple_of(2), 0);
        }
        entries.push((tag, kind, (whole.len() / size) as u32, value));
    }
    let directory = (file.len() as u32).to_le_bytes();
    file[4..8].copy_from_slice(&directory);
    file.extend((entries.len() as u16).to_le_bytes());
    for (tag, kind, count, value) in entries {
        file.extend(tag.to_le_bytes());
        file.extend(kind.to_le_bytes());
        file.extend(count.to_le_bytes());
        file.extend(value);
    }
    file.extend([0; 4]);
    file
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::crs::Crs;

    fn bytes(keys: &[u16]) -> Vec<u8> {
        keys.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    #[test]
    fn keys_that_spell_a_system_out_are_read() {
        // Mississippi West in feet of the survey: the code of the metric system, and the unit.
        let keys = bytes(&[1, 1, 0, 4, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 26_995, 3076, 0, 1, 9003]);
        let wkt = wkt([Some(&keys), None, None]).expect("a system");
        let crs = Crs::parse(&wkt).expect("a projection");
        assert!((crs.metres_per_unit() - 1200.0 / 3937.0).abs() < 1e-9, "{wkt}");
        assert_eq!(crs.epsg(), None, "the system of that code counts in metres");
        let unknown = bytes(&[1, 1, 0, 3, 1024, 0, 1, 1, 3072, 0, 1, 26_995, 3076, 0, 1, 65_535]);
        let wkt = super::wkt([Some(&unknown), None, None]).expect("the system of the code");
        assert_eq!(Crs::parse(&wkt).expect("a projection").epsg(), Some(26_995));
        assert!(super::wkt([None, None, None]).is_none());
        assert!(super::wkt([Some(&keys[..5]), None, None]).is_none());
        // Cut anywhere, it is answered.
        for end in 0..keys.len() {
            let _ = super::wkt([Some(&keys[..end]), Some(&[1, 2, 3]), Some(b"|")]);
        }
    }
}
