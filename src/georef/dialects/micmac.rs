//! MicMac's pair of files: ground points (`DicoAppuisFlottant`) and their places in the image
//! (`SetOfMesureAppuisFlottants`). Pixels are written as GDAL counts them, from the outer corner of the first pixel.

use std::path::Path;

use quick_xml::escape::escape;

use super::{TiePoints, required_height, write_file};
use autoref_raster::error::Result;

/// 1σ of a point whose survey says nothing, metres: what MicMac's own tools write.
const UNKNOWN_SIGMA_M: f64 = 1.0;

/// Writes both files.
///
/// # Errors
/// When a file cannot be written, or a point has no height.
pub fn write(ground: &Path, image: &Path, tie_points: &TiePoints) -> Result<()> {
    let mut appuis = String::from("<?xml version=\"1.0\" ?>\n<DicoAppuisFlottant>\n");
    let mut mesures = format!(
        "<?xml version=\"1.0\" ?>\n<SetOfMesureAppuisFlottants>\n     <MesureAppuiFlottant1Im>\n          <NameIm>{}</NameIm>\n",
        escape(tie_points.image_name.as_str())
    );
    for pair in &tie_points.pairs {
        let height = required_height("MicMac", pair)?;
        let sigma_m = pair.sigma_m.unwrap_or(UNKNOWN_SIGMA_M);
        let sigma_height_m = pair.sigma_height_m.unwrap_or(sigma_m);
        let name = escape(pair.name.as_str());
        appuis.push_str(&format!(
            "     <OneAppuisDAF>\n          <Pt>{} {} {height}</Pt>\n          <NamePt>{name}</NamePt>\n          \
             <Incertitude>{sigma_m} {sigma_m} {sigma_height_m}</Incertitude>\n     </OneAppuisDAF>\n",
            pair.easting, pair.northing
        ));
        mesures.push_str(&format!(
            "          <OneMesureAF1I>\n               <NamePt>{name}</NamePt>\n               <PtIm>{} {}</PtIm>\n          \
             </OneMesureAF1I>\n",
            pair.pixel.x, pair.pixel.y
        ));
    }
    appuis.push_str("</DicoAppuisFlottant>\n");
    mesures.push_str("     </MesureAppuiFlottant1Im>\n</SetOfMesureAppuisFlottants>\n");
    write_file(ground, &appuis)?;
    write_file(image, &mesures)
}
