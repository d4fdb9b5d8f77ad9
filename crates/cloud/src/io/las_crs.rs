//! What a LAS header says of places and heights: WKT, or the keys of GeoTIFF.

use autoref_raster::crs::Crs;
use autoref_raster::units::{FOOT_M, US_SURVEY_FOOT_M};

use super::geokeys;
use super::las_header::{LasHeader, Vlr, text_of, u16_at};

/// The records that WKT stands in; liblas wrote a second one.
const WKT: u16 = 2112;
/// The records of GeoTIFF keys, their doubles and their texts.
const KEYS: [u16; 3] = [34_735, 34_736, 34_737];

impl LasHeader {
    /// WKT, or `EPSG:n` from the GeoTIFF keys; `EPSG:n+m` where they name the heights too.
    pub fn crs(&self) -> Option<String> {
        let wkt = self.vlr("LASF_Projection", WKT).map(|vlr| text_of(&vlr.content));
        // Some programs write a pair of quotation marks for none.
        let wkt = wkt.filter(|text| text.contains(|letter: char| letter.is_ascii_alphanumeric()));
        wkt.or_else(|| {
            let code = |id: u16| self.key(id).filter(|&value| value > 1000 && value < 32_767);
            // ProjectedCSTypeGeoKey, else GeographicTypeGeoKey, which is the system of the coordinates only where no
            // projection is meant, nor coordinates from the Earth's centre (GTModelTypeGeoKey 2, or none).
            let is_geographic = self.key(1024).is_none_or(|model| model == 2) && self.key(3072).is_none();
            let flat = code(3072).filter(|code| self.counts_in_unit_of(*code));
            let Some(flat) = flat.or_else(|| code(2048).filter(|_| is_geographic)) else {
                let wkt = geokeys::wkt(KEYS.map(|id| self.vlr("LASF_Projection", id).map(|vlr| &vlr.content[..])))?;
                // Below a projection that cannot be made out nothing is known of the coordinates.
                let fits = |crs: Crs| is_geographic || !crs.is_geographic();
                return Crs::parse(&wkt).is_ok_and(fits).then_some(wkt);
            };
            let flat = format!("EPSG:{flat}");
            // VerticalCSTypeGeoKey, in which old files have codes of other things.
            let both = code(4096).map(|vertical| format!("{flat}+{vertical}"));
            Some(both.filter(|both| Crs::parse(both).is_ok()).unwrap_or(flat))
        })
    }

    /// Whether ProjLinearUnitsGeoKey, where it is there, names the unit of the projected system: a system in metres
    /// may be meant in feet.
    fn counts_in_unit_of(&self, code: u16) -> bool {
        let stated_m = match self.key(3076) {
            Some(9001) => 1.0,
            Some(9002) => FOOT_M,
            Some(9003) => US_SURVEY_FOOT_M,
            Some(_) | None => return true,
        };
        Crs::parse(&format!("EPSG:{code}")).map_or(true, |crs| (crs.metres_per_unit() / stated_m - 1.0).abs() < 1e-9)
    }

    /// The unit of heights as bands of rasters name it: what VerticalUnitsGeoKey says, which no WKT contradicts.
    ///
    /// # Errors
    /// The key's code, where it names a unit that is not known.
    pub fn height_unit(&self) -> Result<Option<&'static str>, u16> {
        match self.key(4099) {
            // Undefined, or what the file defines itself.
            None | Some(0 | 32_767) => Ok(None),
            Some(9001) => Ok(Some("m")),
            Some(9002) => Ok(Some("ft")),
            Some(9003) => Ok(Some("US survey foot")),
            Some(9036) => Ok(Some("km")),
            Some(1033) => Ok(Some("cm")),
            Some(1025) => Ok(Some("mm")),
            Some(code) => Err(code),
        }
    }

    /// Takes out what names the reference system.
    pub(crate) fn forget_crs(&mut self) {
        let names = |vlr: &Vlr| match vlr.user_id.as_str() {
            "LASF_Projection" => vlr.record_id == WKT || KEYS.contains(&vlr.record_id),
            "liblas" => vlr.record_id == WKT,
            _ => false,
        };
        self.vlrs.retain(|vlr| !names(vlr));
        self.raw[6] &= !0x10;
    }

    /// A GeoTIFF key whose value is a number.
    fn key(&self, wanted: u16) -> Option<u16> {
        let keys = &self.vlr("LASF_Projection", KEYS[0])?.content;
        keys.chunks_exact(8).skip(1).find_map(|key| {
            let (id, location, value) = (u16_at(key, 0), u16_at(key, 2), u16_at(key, 6));
            (id == wanted && location == 0).then_some(value)
        })
    }
}
