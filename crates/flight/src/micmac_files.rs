//! What MicMac (`mm3d`, and MMVII) reads to orient a flight: the camera, pairs of images, GCPs on the ground and in the
//! images, and the command lines of the 2017 thesis.
//!
//! Source: `include/XML_GEN/ParamChantierPhotogram.xml` of MicMac and files that MicMac and MMVII wrote;
//! [`crate::read::micmac`] reads the points back. Pixels as everywhere here, as MicMac counts them.

use quick_xml::escape::escape;

/// The camera of all frames. MicMac derives the focal length in pixels from millimetres: only their ratio to the
/// pixel's size counts.
#[derive(Clone, Debug, PartialEq)]
pub struct FilmCamera {
    pub name: String,
    pub f_mm: f64,
    /// Width and height of the frames, millimetres.
    pub size_mm: [f64; 2],
}

/// A point on the ground with the places where it was seen: image and pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct SurveyedPoint {
    pub name: String,
    pub xyz: [f64; 3],
    /// 1σ of x, y, z, metres.
    pub sigma_m: [f64; 3],
    pub seen: Vec<(String, [f64; 2])>,
}

/// A file: its name and its text.
pub type TextFile = (String, String);

/// `MicMac-LocalChantierDescripteur.xml`: the camera of all images that the regular expression `images` takes.
pub fn camera_database(camera: &FilmCamera, images: &str) -> TextFile {
    let name = escape(camera.name.as_str());
    let [w, h] = camera.size_mm;
    let association = |key: &str, value: &str| {
        format!(
            "    <KeyedNamesAssociations>\n      <Calcs>\n        <Arrite> 1 1 </Arrite>\n        <Direct>\n          \
             <PatternTransform> {} </PatternTransform>\n          <CalcName> {value} </CalcName>\n        </Direct>\n      \
             </Calcs>\n      <Key> {key} </Key>\n    </KeyedNamesAssociations>\n",
            escape(images)
        )
    };
    let text = format!(
        "<?xml version=\"1.0\" ?>\n<Global>\n  <ChantierDescripteur>\n    <LocCamDataBase>\n      <CameraEntry>\n        \
         <Name> {name} </Name>\n        <SzCaptMm> {w} {h} </SzCaptMm>\n        <ShortName> {name} </ShortName>\n      \
         </CameraEntry>\n    </LocCamDataBase>\n{}{}  </ChantierDescripteur>\n</Global>\n",
        association("NKS-Assoc-STD-CAM", &name),
        association("NKS-Assoc-STD-FOC", &camera.f_mm.to_string())
    );
    ("MicMac-LocalChantierDescripteur.xml".into(), text)
}

/// `NameCpleVisib.xml`: the pairs of images that `Tapioca File` compares.
pub fn image_pairs(pairs: &[(String, String)]) -> TextFile {
    let mut text = String::from("<?xml version=\"1.0\" ?>\n<SauvegardeNamedRel>\n");
    for (a, b) in pairs {
        text += &format!("     <Cple>{} {}</Cple>\n", escape(a.as_str()), escape(b.as_str()));
    }
    ("NameCpleVisib.xml".into(), text + "</SauvegardeNamedRel>\n")
}

/// `NAME-S3D.xml` (`DicoAppuisFlottant`) and `NAME-S2D.xml` (`SetOfMesureAppuisFlottants`), as `SaisieAppuisPredic`
/// writes them.
pub fn points_v1(name: &str, points: &[SurveyedPoint]) -> [TextFile; 2] {
    let mut ground = String::from("<?xml version=\"1.0\" ?>\n<DicoAppuisFlottant>\n");
    for p in points {
        let ([x, y, z], [sx, sy, sz]) = (p.xyz, p.sigma_m);
        ground += &format!(
            "     <OneAppuisDAF>\n          <Pt>{x} {y} {z}</Pt>\n          <NamePt>{}</NamePt>\n          \
             <Incertitude>{sx} {sy} {sz}</Incertitude>\n     </OneAppuisDAF>\n",
            escape(p.name.as_str())
        );
    }
    ground += "</DicoAppuisFlottant>\n";
    let mut images = String::from("<?xml version=\"1.0\" ?>\n<SetOfMesureAppuisFlottants>\n");
    for image in images_of(points) {
        images += &format!("     <MesureAppuiFlottant1Im>\n          <NameIm>{}</NameIm>\n", escape(image.as_str()));
        for (point, [x, y]) in seen_in(points, &image) {
            images += &format!(
                "          <OneMesureAF1I>\n               <NamePt>{}</NamePt>\n               <PtIm>{x} {y}</PtIm>\n          \
                 </OneMesureAF1I>\n",
                escape(point)
            );
        }
        images += "     </MesureAppuiFlottant1Im>\n";
    }
    images += "</SetOfMesureAppuisFlottants>\n";
    [(format!("{name}-S3D.xml"), ground), (format!("{name}-S2D.xml"), images)]
}

/// `MesGCP-NAME.xml` and a `MesIm-IMAGE.xml` for every image: MMVII's form. `sigma_px` is 1σ of a measurement.
pub fn points_mmvii(name: &str, points: &[SurveyedPoint], sigma_px: f64) -> Vec<TextFile> {
    let frame = |data: &str| {
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"yes\" ?>\n<Root>\n   <Type>\"MMVII_Serialization\"</Type>\n   \
             <Version>\"0.0.0\"</Version>\n   <Data>\n{data}   </Data>\n</Root>\n"
        )
    };
    let mut ground = format!("      <SetGCP>\n         <NameSet>\"{}\"</NameSet>\n         <Measures>\n", escape(name));
    for p in points {
        let ([x, y, z], [vx, vy, vz]) = (p.xyz, p.sigma_m.map(|s| s * s));
        ground += &format!(
            "            <el>\n               <Name>\"{}\"</Name>\n               <Pt>{x} {y} {z}</Pt>\n               \
             <AdditionalInfo>\"\"</AdditionalInfo>\n               <__Opt__Sigma2>{vx} 0 0 {vy} 0 {vz}</__Opt__Sigma2>\n            </el>\n",
            escape(p.name.as_str())
        );
    }
    ground += "         </Measures>\n      </SetGCP>\n";
    let mut files = vec![(format!("MesGCP-{name}.xml"), frame(&ground))];
    let variance = sigma_px * sigma_px;
    for image in images_of(points) {
        let mut set = format!(
            "      <SetMesIm>\n         <NameIm>\"{}\"</NameIm>\n         <Measures>\n",
            escape(image.as_str())
        );
        for (point, [x, y]) in seen_in(points, &image) {
            set += &format!(
                "            <el>\n               <Name>\"{}\"</Name>\n               <Pt>{x} {y}</Pt>\n               \
                 <Sigma2>{variance} 0 {variance}</Sigma2>\n            </el>\n",
                escape(point)
            );
        }
        set += "         </Measures>\n      </SetMesIm>\n";
        files.push((format!("MesIm-{image}.xml"), frame(&set)));
    }
    files
}

/// What the chain of commands depends on.
#[derive(Clone, Copy, Debug)]
pub struct Chain<'a> {
    /// A regular expression that takes the images.
    pub images: &'a str,
    /// The name given to [`points_v1`].
    pub points: &'a str,
    pub masks: Masks,
    /// 1σ of the points on the ground, in units of their coordinates.
    pub sigma_ground: f64,
    /// 1σ of the points in the images, pixels.
    pub sigma_px: f64,
    /// Where the relative orientation starts its principal point, as shares of the image's width and height from its
    /// upper left corner, which must not be negative; `None` for the middle.
    pub principal_point: Option<[f64; 2]>,
}

/// `commands.sh`: the thesis's chain in `mm3d`.
pub fn commands(chain: &Chain<'_>) -> TextFile {
    let Chain { images, points, masks, sigma_ground, sigma_px, principal_point } = *chain;
    // Between single quotes a shell takes everything but the quote itself.
    let quoted = format!("'{}'", images.replace('\'', "'\\''"));
    let filter = match masks {
        Masks::Beside => {
            format!("mm3d HomolFilterMasq {quoted} KeyCalculMasq=NKS-Assoc-STD-Masq\nHOMOL='SH=MasqFiltered'\n")
        }
        Masks::None => "HOMOL=''\n".into(),
    };
    let start = principal_point.map_or_else(String::new, |[x, y]| format!(" 'PPRel=[{x},{y}]'"));
    let text = format!(
        "#!/bin/sh\n# Relative orientation, GCPs and compensation by MicMac; run it in the folder of the images.\nset -e\n\
         mm3d Tapioca File NameCpleVisib.xml -1\n{filter}\
         mm3d Tapas FraserBasic {quoted} Out=Relative{start} $HOMOL\n\
         mm3d AperiCloud {quoted} Relative $HOMOL\n\
         mm3d GCPBascule {quoted} Relative Absolute {points}-S3D.xml {points}-S2D.xml\n\
         mm3d Campari {quoted} Absolute Compensated GCP=[{points}-S3D.xml,{sigma_ground},{points}-S2D.xml,{sigma_px}] $HOMOL\n"
    );
    ("commands.sh".into(), text)
}

/// Whether images have masks beside them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Masks {
    None,
    /// `NAME_Masq.tif` and its XML.
    Beside,
}

fn images_of(points: &[SurveyedPoint]) -> Vec<String> {
    let mut images: Vec<String> = points.iter().flat_map(|p| p.seen.iter().map(|s| s.0.clone())).collect();
    images.sort();
    images.dedup();
    images
}

fn seen_in<'a>(points: &'a [SurveyedPoint], image: &'a str) -> impl Iterator<Item = (&'a str, [f64; 2])> {
    points.iter().flat_map(move |p| p.seen.iter().filter(move |s| s.0 == image).map(move |s| (p.name.as_str(), s.1)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::read::micmac;

    fn points() -> Vec<SurveyedPoint> {
        let seen = |pairs: &[(&str, [f64; 2])]| pairs.iter().map(|(n, p)| ((*n).to_string(), *p)).collect();
        vec![
            SurveyedPoint {
                name: "Østre & <topp>".into(),
                xyz: [447_618.893, 8_759_606.114, 410.523],
                sigma_m: [25.0, 25.0, 10.0],
                seen: seen(&[("b.tif", [0.1, 1e-7]), ("a.tif", [1341.25, 358.5])]),
            },
            SurveyedPoint {
                name: "2".into(),
                xyz: [-0.1, 0.2, -3.0],
                sigma_m: [1.0; 3],
                seen: seen(&[("a.tif", [7.0, 8.0])]),
            },
        ]
    }

    /// Image, point, pixel.
    type Seen = (String, String, [f64; 2]);

    fn read_back(files: &[TextFile]) -> (Vec<micmac::GroundPoint>, Vec<Seen>) {
        let folder = tempfile::tempdir().expect("a folder");
        let mut ground = Vec::new();
        let mut images = Vec::new();
        for (name, text) in files {
            let path = folder.path().join(name);
            std::fs::write(&path, text).expect("written");
            match micmac::has_image_points(&path) {
                true => images.extend(micmac::read_image_points(&path).expect("image points")),
                false => ground.extend(micmac::read_ground_points(&path).expect("ground points")),
            }
        }
        (ground, images)
    }

    #[test]
    fn both_forms_read_back_as_they_were() {
        let points = points();
        for files in [points_v1("GCP", &points).to_vec(), points_mmvii("GCP", &points, 5.0)] {
            let (ground, images) = read_back(&files);
            assert_eq!(ground.len(), 2);
            for (read, point) in ground.iter().zip(&points) {
                assert_eq!((&read.name, read.xyz, read.sigma), (&point.name, point.xyz, Some(point.sigma_m)));
            }
            let all: usize = points.iter().map(|p| p.seen.len()).sum();
            assert_eq!(images.len(), all);
            for (image, name, pixel) in images {
                let point = points.iter().find(|p| p.name == name).expect("a point of the list");
                assert!(point.seen.contains(&(image, pixel)));
            }
        }
    }

    #[test]
    fn shells_and_xml_take_names_as_they_are() {
        let images = "it's .*\\.tif";
        let (points, masks, principal_point) = ("GCP", Masks::Beside, Some([0.505, 0.5]));
        let chain = Chain { images, points, masks, sigma_ground: 25.0, sigma_px: 5.0, principal_point };
        let (_, script) = commands(&chain);
        assert!(script.contains("'it'\\''s .*\\.tif'") && script.contains("MasqFiltered"));
        assert!(script.contains(" Out=Relative 'PPRel=[0.505,0.5]' $HOMOL\n"), "{script}");
        let (_, script) = commands(&Chain { principal_point: None, ..chain });
        assert!(script.contains(" Out=Relative $HOMOL\n"), "{script}");
        let (_, pairs) = image_pairs(&[("a&b.tif".into(), "c.tif".into())]);
        assert!(pairs.contains("<Cple>a&amp;b.tif c.tif</Cple>"));
        let camera = FilmCamera { name: "Zeiss".into(), f_mm: 210.71, size_mm: [180.0, 180.0] };
        assert!(camera_database(&camera, ".*tif").1.contains("<CalcName> 210.71 </CalcName>"));
    }
}
