//! The detector that a profile asks for: paint by its colour, black and white targets by their shape, or coded targets.

use crate::black_white::TargetDetector;
#[cfg(feature = "coded")]
use crate::coded::CodedDetector;
use crate::detector::Detector;
use crate::pipeline::PaintDetector;
use crate::pipeline::paint::ProfileColours;
use crate::profile::Profile;
use autoref_raster::RasterInfo;
use autoref_raster::error::Result;

/// Finds the marks of any profile.
pub enum MarkDetector {
    Paint(Box<PaintDetector>),
    Target(Box<TargetDetector>),
    #[cfg(feature = "coded")]
    Coded(Box<CodedDetector>),
}

impl MarkDetector {
    /// # Errors
    /// When the profile is not valid, or gives sizes in metres and `gsd_m` is unknown, or asks for coded targets in a
    /// build without the cargo feature `coded`.
    pub fn new(profile: Profile, info: &RasterInfo, gsd_m: Option<f64>) -> Result<Self> {
        let colours = MarkDetector::colours(&profile)?;
        MarkDetector::with_colours(profile, colours, info, gsd_m)
    }

    /// The colours of a profile of paint, for [`MarkDetector::with_colours`]: they take time and no image.
    ///
    /// # Errors
    /// When the profile is not valid.
    pub fn colours(profile: &Profile) -> Result<Option<ProfileColours>> {
        let is_paint = profile.tag.is_none() && !profile.is_target();
        is_paint.then(|| ProfileColours::of(profile)).transpose()
    }

    /// The same with what [`MarkDetector::colours`] said of the profile.
    ///
    /// # Errors
    /// As [`MarkDetector::new`].
    pub fn with_colours(
        profile: Profile,
        colours: Option<ProfileColours>,
        info: &RasterInfo,
        gsd_m: Option<f64>,
    ) -> Result<Self> {
        match colours {
            Some(colours) => {
                let paint = PaintDetector::with_colours(profile, colours, info, gsd_m)?;
                Ok(MarkDetector::Paint(Box::new(paint)))
            }
            None if profile.tag.is_some() => coded(profile, info, gsd_m),
            None => Ok(MarkDetector::Target(Box::new(TargetDetector::new(profile, info, gsd_m)?))),
        }
    }

    /// For places where a mark must be: a weak score is enough.
    pub fn relaxed(&self) -> Self {
        match self {
            MarkDetector::Paint(paint) => MarkDetector::Paint(Box::new(paint.relaxed())),
            MarkDetector::Target(target) => MarkDetector::Target(Box::new(target.relaxed())),
            #[cfg(feature = "coded")]
            MarkDetector::Coded(coded) => MarkDetector::Coded(Box::new(coded.relaxed())),
        }
    }

    /// What every kind of mark can be asked.
    pub fn as_detector(&self) -> &dyn Detector {
        match self {
            MarkDetector::Paint(paint) => paint.as_ref(),
            MarkDetector::Target(target) => target.as_ref(),
            #[cfg(feature = "coded")]
            MarkDetector::Coded(coded) => coded.as_ref(),
        }
    }
}

#[cfg(feature = "coded")]
fn coded(profile: Profile, info: &RasterInfo, gsd_m: Option<f64>) -> Result<MarkDetector> {
    Ok(MarkDetector::Coded(Box::new(CodedDetector::new(profile, info, gsd_m)?)))
}

#[cfg(not(feature = "coded"))]
fn coded(profile: Profile, _info: &RasterInfo, _gsd_m: Option<f64>) -> Result<MarkDetector> {
    Err(autoref_raster::Error::usage(
        format!("profile \"{}\" asks for coded targets, and this program was built without them", profile.name),
        "build it with `cargo build --release --features coded`",
    ))
}

#[cfg(all(test, not(feature = "coded")))]
mod tests {
    use super::*;
    use autoref_raster::RasterSource;
    use autoref_raster::memory::MemorySource;

    #[test]
    fn without_the_feature_coded_targets_are_refused_in_one_line() {
        let source = MemorySource::rgb8(8, 8, vec![0; 192]);
        let profile = Profile::builtin("aruco-4x4-50").expect("shipped");
        let message = MarkDetector::new(profile, source.info(), None).err().expect("built without").to_string();
        assert!(message.contains("--features coded") && !message.contains('\n'), "{message}");
    }
}
