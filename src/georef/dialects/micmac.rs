//! MicMac's pair of files: ground points (`DicoAppuisFlottant`) and their places in the image
//! (`SetOfMesureAppuisFlottants`). Pixels are written as GDAL counts them, from the outer corner of the first pixel.

use std::path::Path;

use quick_xml::escape::escape;

use super::{TiePoints, no_height, write_file};
use crate::gcp::programs;
use autoref_raster::error::Result;

/// Writes both files.
///
/// # Errors
/// When a file cannot be written, or a point has no height.
pub fn write(ground: &Path, image: &Path, tie_points: &TiePoints) -> Result<()> {
    let appuis =
        programs::micmac(tie_points.gcps(), tie_points.crs.as_ref()).map_err(|name| no_height("MicMac", name))?;
    let mut mesures = format!(
        "<?xml version=\"1.0\" ?>\n<SetOfMesureAppuisFlottants>\n     <MesureAppuiFlottant1Im>\n          <NameIm>{}</NameIm>\n",
        escape(tie_points.image_name.as_str())
    );
    for pair in &tie_points.pairs {
        mesures.push_str(&format!(
            "          <OneMesureAF1I>\n               <NamePt>{}</NamePt>\n               <PtIm>{} {}</PtIm>\n          \
             </OneMesureAF1I>\n",
            escape(pair.gcp.name.as_str()),
            pair.pixel.x,
            pair.pixel.y
        ));
    }
    mesures.push_str("     </MesureAppuiFlottant1Im>\n</SetOfMesureAppuisFlottants>\n");
    write_file(ground, &appuis)?;
    write_file(image, &mesures)
}
