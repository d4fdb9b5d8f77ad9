//! Bands and light of `mask`: the film's corrections and the thesis's, as changes of the reduced frame.

use std::sync::Arc;

use autoref_film::resample::banding::{self, Banding};
use autoref_film::resample::lighting::{self, CELLS, Cells};
use autoref_film::window::Grey;
use autoref_raster::RasterSource;
use autoref_raster::error::Result;
use autoref_raster::window::Window;
use autoref_terrain::light::{self, Correction};
use autoref_terrain::reduce::Reduced;
use autoref_terrain::smooth::gaussian_line;
use clap::ValueEnum;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LightingArg {
    None,
    /// A surface that grows with the square of the distance from the middle, fitted robustly (the film's).
    Frame,
    /// Ever smaller boxes, and their complement added (equations 10.1–10.3).
    #[value(name = "thesis-2017")]
    Thesis2017,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BandingArg {
    Off,
    Rows,
    Columns,
    Both,
}

/// Bands first, as the film does.
pub fn corrections(lighting: LightingArg, banding: BandingArg) -> Vec<Correction> {
    let directions: &'static [Banding] = match banding {
        BandingArg::Off => &[],
        BandingArg::Rows => &[Banding::Rows],
        BandingArg::Columns => &[Banding::Columns],
        BandingArg::Both => &[Banding::Rows, Banding::Columns],
    };
    let mut corrections: Vec<Correction> = directions
        .iter()
        .map(|&which| Correction {
            name: format!("bands along {}", which.name()),
            change: Arc::new(move |source, reduced| remove_bands(source, reduced, which)),
        })
        .collect();
    match lighting {
        LightingArg::None => {}
        LightingArg::Frame => corrections
            .push(Correction { name: "light of the frame".into(), change: Arc::new(|_, reduced| even(reduced)) }),
        LightingArg::Thesis2017 => corrections.push(Correction {
            name: "light of thesis-2017".into(),
            change: Arc::new(|_, reduced| light::thesis_2017(reduced)),
        }),
    }
    corrections
}

/// Measures bands on the scan without a twentieth at either end of them, where the film's border may be.
fn remove_bands(source: &dyn RasterSource, reduced: &mut Reduced, which: Banding) -> Result<()> {
    let (w, h) = (reduced.width, reduced.height);
    let region = match which {
        Banding::Columns => Window::new(0, h / 20, w, h - 2 * (h / 20)),
        _ => Window::new(w / 20, 0, w - 2 * (w / 20), h),
    };
    let bands = banding::find(source, region, which)?;
    let (factor, steps) = (reduced.factor, reduced.white_steps);
    // The bands at every row or column are what they take from zero; they were smoothed and reduced with the frame.
    let taken = |width: u64, height: u64| -> Vec<f64> {
        let (width, height) = (width as usize, height as usize);
        let mut grey = Grey { width, height, data: vec![0.0; width * height], origin: [0, 0], factor: 1 };
        bands.remove(&mut grey);
        let line = if reduced.smooth { gaussian_line(&grey.data) } else { grey.data };
        line.chunks(factor).map(|part| part.iter().map(|v| f64::from(*v)).sum::<f64>() / part.len() as f64).collect()
    };
    if which == Banding::Columns {
        let taken = taken(w, 1);
        light::change_levels(reduced, |x, _, level| level + steps * taken[x])
    } else {
        let taken = taken(1, h);
        light::change_levels(reduced, |_, y, level| level + steps * taken[y])
    }
}

/// The film's light of one frame, measured on cells of the reduced frame.
fn even(reduced: &mut Reduced) -> Result<()> {
    let (w, h) = (reduced.grey.width(), reduced.grey.height());
    let mut histograms = vec![[0u32; 256]; CELLS * CELLS];
    let mut all = [0u64; 256];
    for y in 0..h {
        let row = reduced.grey.read(&Window::new(0, y as u64, w as u64, 1))?;
        for (x, &level) in row.iter().enumerate().filter(|(x, _)| reduced.valid.get(*x, y)) {
            histograms[y * CELLS / h * CELLS + x * CELLS / w][usize::from(level)] += 1;
            all[usize::from(level)] += 1;
        }
    }
    let total: u64 = all.iter().sum();
    let mut below = 0;
    let darkest = all.iter().position(|count| {
        below += count;
        // The darkest 0.2 % say where black is.
        below * 500 > total
    });
    let black = darkest.unwrap_or(0) as f64 / 255.0;
    let median = |histogram: &[u32; 256]| {
        let count: u32 = histogram.iter().sum();
        let mut below = 0;
        let middle = (0..256).find(|&level| {
            below += histogram[level];
            count > 0 && 2 * below >= count
        })?;
        let middle = middle as f64 / 255.0;
        // Without grey steps nothing can be said of light.
        (middle > black + 0.004 && middle < 0.985).then_some(middle - black)
    };
    let cells = Cells { black, values: histograms.iter().map(median).collect() };
    let Some(lighting) = lighting::of_frame(&cells) else {
        tracing::warn!("the frame shows too little to tell its light; it is left as it is");
        return Ok(());
    };
    let place = |v: usize, n: usize| (2.0 * v as f64 + 1.0) / n as f64 - 1.0;
    light::change_levels(reduced, |x, y, level| {
        255.0 * f64::from(lighting.corrected((level / 255.0) as f32, [place(x, w), place(y, h)]))
    })
}
