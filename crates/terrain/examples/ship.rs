//! Feature values of licensed photographs, as `src/shipped.bin` holds them: `ship OUT MOST FRAME=MASK.tif…`.
//! At most MOST pixels of each class and frame; the masks hold 1 (keep), 0 (mask) and 255 (unknown).

use autoref_raster::ReaderChoice;
use autoref_terrain::model::{Labels, examples};
use autoref_terrain::reduce::{Reading, reduce_frame};
use autoref_terrain::shapes::parse_lesson;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [out, most, frames @ ..] = &arguments[..] else {
        return Err("ship OUT MOST FRAME=MASK.tif…".into());
    };
    let mut bytes = Vec::new();
    for lesson in frames {
        let lesson = parse_lesson(lesson)?;
        let source = autoref_raster::open(&lesson.frame, ReaderChoice::Auto, 0, 64 << 20)?;
        let side = source.info().width.max(source.info().height);
        let factor = if side < 1500 {
            1
        } else if side < 3000 {
            2
        } else {
            4
        };
        let reading = Reading { factor, smooth: factor > 1, tile_px: 0, memory_budget_bytes: 1 << 30, masks_beside: 0 };
        let reduced = reduce_frame(&source, &reading)?;
        let mut labels = Labels::new(&reduced);
        labels.read_mask(&lesson.mask, &reduced)?;
        let rows = examples(&reduced, &labels, most.parse()?, 1)?;
        println!("{}: {} px, reduced {factor}, {} examples", lesson.frame.display(), side, rows.len());
        for row in rows {
            bytes.extend(row.features);
            bytes.push(u8::from(row.keep));
        }
    }
    Ok(std::fs::write(out, bytes)?)
}
