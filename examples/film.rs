//! Finds the fiducial marks of a frame of scanned film and prints its interior orientation.
//!
//! `cargo run --release -p autoref-film --example film`; the frame is drawn.

use autoref_film::drawn::{FilmGround, FilmScene, FilmSpec};
use autoref_film::frame::{FindOptions, Finder};
use autoref_film::load_camera;

pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let camera = load_camera("wild-15-4")?;
    let scene = FilmScene::new(&FilmSpec::plain(&camera, 60.0, 3), &FilmGround::default())?;
    let frame = Finder::new(&camera)?.find(&scene, &FindOptions::default())?;
    let found = frame.marks.iter().filter(|mark| mark.centre.is_some()).count();
    println!("{found} of {} marks found; usable without a look: {}", camera.marks.len(), frame.is_ok());
    if let Some(interior) = &frame.interior {
        println!("scan pixels to film millimetres: {:?}", interior.pixel_to_mm);
    }
    Ok(())
}
