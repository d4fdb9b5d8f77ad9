//! Systems by the names that EPSG gives them, which GDAL's own reading of definitions does not know: "Amersfoort / RD
//! New", "ETRS89 / UTM zone 32N + NN2000 height".

use std::collections::HashMap;
use std::ffi::CStr;
use std::sync::OnceLock;

use gdal_sys::OSRCRSType;

/// Codes by name, each with whether it is a vertical system. A name that several have is none.
type Codes = HashMap<String, Option<(u32, Kind)>>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Horizontal,
    Vertical,
    Compound,
}

/// The definition by codes of a system that is named as EPSG does, or of two joined by a plus.
pub(super) fn definition(name: &str) -> Option<String> {
    if name.len() > 200 || !name.contains(' ') {
        return None;
    }
    let found = |name: &str| codes().get(&plain(name)).copied().flatten();
    if let Some((code, kind)) = found(name) {
        return (kind != Kind::Vertical).then(|| format!("EPSG:{code}"));
    }
    let (map, height) = name.split_once(" + ")?;
    match (found(map)?, found(height)?) {
        ((map, Kind::Horizontal), (height, Kind::Vertical)) => Some(format!("EPSG:{map}+{height}")),
        _ => None,
    }
}

/// Names as they are compared: small letters, one blank between words.
fn plain(name: &str) -> String {
    name.to_lowercase().split_whitespace().collect::<Vec<_>>().join(" ")
}

fn codes() -> &'static Codes {
    static CODES: OnceLock<Codes> = OnceLock::new();
    CODES.get_or_init(read)
}

#[allow(unsafe_code)]
fn read() -> Codes {
    let mut codes = Codes::new();
    let mut count = 0;
    // SAFETY: the name of the authority ends with a zero; no parameters means all systems; the count is written to.
    let list = unsafe { gdal_sys::OSRGetCRSInfoListFromDatabase(c"EPSG".as_ptr(), std::ptr::null(), &raw mut count) };
    if list.is_null() {
        return codes;
    }
    for at in 0..usize::try_from(count).unwrap_or(0) {
        // SAFETY: the list holds `count` pointers to entries, which live until it is destroyed.
        let entry = unsafe { &**list.add(at) };
        let kind = match entry.eType {
            OSRCRSType::OSR_CRS_TYPE_GEOGRAPHIC_2D | OSRCRSType::OSR_CRS_TYPE_PROJECTED => Kind::Horizontal,
            OSRCRSType::OSR_CRS_TYPE_VERTICAL => Kind::Vertical,
            OSRCRSType::OSR_CRS_TYPE_COMPOUND => Kind::Compound,
            _ => continue,
        };
        if entry.bDeprecated != 0 || entry.pszName.is_null() || entry.pszCode.is_null() {
            continue;
        }
        // SAFETY: both are texts that end with a zero, of the entry.
        let (name, code) = unsafe { (CStr::from_ptr(entry.pszName), CStr::from_ptr(entry.pszCode)) };
        if let (Ok(name), Ok(Ok(code))) = (name.to_str(), code.to_str().map(str::parse)) {
            codes.entry(plain(name)).and_modify(|known| *known = None).or_insert(Some((code, kind)));
        }
    }
    // SAFETY: it came from the call above and is not used any more.
    unsafe { gdal_sys::OSRDestroyCRSInfoList(list) };
    codes
}

#[cfg(test)]
mod tests {
    use super::super::Crs;

    #[test]
    fn systems_are_known_by_their_names() {
        for (name, code) in [
            ("Amersfoort / RD New", 28992),
            ("amersfoort / rd new", 28992),
            ("OSGB36 / British National Grid", 27700),
            ("NAD83(2011) / Texas South Central (ftUS)", 6588),
            ("CH1903+ / LV95", 2056),
        ] {
            assert_eq!(Crs::parse(name).unwrap_or_else(|e| panic!("{name}: {e}")).epsg(), Some(code), "{name}");
        }
        let both = Crs::parse("ETRS89 / UTM zone 32N + NN2000 height").expect("both are known");
        assert_eq!((both.height_metres_per_unit(), both.metres_per_unit()), (Some(1.0), 1.0));
        for name in ["NN2000 height", "No such / System", "Amersfoort / RD New + no height"] {
            assert!(Crs::parse(name).is_err(), "{name}");
        }
    }
}
