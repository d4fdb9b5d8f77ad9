//! One step of the mask on raw 8-bit pixels, for comparison with other libraries:
//! `steps STEP WIDTH HEIGHT IN OUT [ARGUMENT]`. `tests/peers.py` calls it.

use autoref_terrain::area::flip_small;
use autoref_terrain::bits::{Bit, BitMask};
use autoref_terrain::clean::{Cleaning, clean};
use autoref_terrain::entropy::{RADIUS_PX, entropy};
use autoref_terrain::knn::{Neighbours, Sample};
use autoref_terrain::morphology::{Kernel, close, dilate, erode};
use autoref_terrain::smooth::{gaussian, reduce};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [step, width, height, input, output, rest @ ..] = &arguments[..] else {
        return Err("steps STEP WIDTH HEIGHT IN OUT [ARGUMENT]".into());
    };
    let (width, height): (usize, usize) = (width.parse()?, height.parse()?);
    let image = std::fs::read(input)?;
    let number =
        || -> Result<f64, Box<dyn std::error::Error>> { Ok(rest.first().ok_or("one argument more")?.parse()?) };
    let mask = || BitMask::from_fn(width, height, |x, y| image[y * width + x] != 0);
    let bytes =
        |mask: BitMask| -> Vec<u8> { (0..width * height).map(|i| u8::from(mask.get(i % width, i / width))).collect() };
    let out = match step.as_str() {
        "gaussian" => gaussian(&image, width, height),
        "reduce" => reduce(&image, width, height, number()? as usize),
        "entropy" => {
            let started = std::time::Instant::now();
            let values = entropy(&image, width, height, RADIUS_PX, 0..height);
            println!("{}", started.elapsed().as_secs_f64());
            values.iter().flat_map(|v| v.to_le_bytes()).collect()
        }
        "knn" => {
            let text = std::fs::read_to_string(rest.first().ok_or("a file of samples")?)?;
            let sample = |line: &str| -> Option<Sample> {
                let mut fields = line.split(' ').map(|field| field.parse::<f64>().ok());
                let (entropy, intensity, keep) = (fields.next()??, fields.next()??, fields.next()??);
                Some(Sample { entropy, intensity, keep: keep > 0.5 })
            };
            let neighbours = Neighbours::new(text.lines().filter_map(sample).collect(), 3)?;
            let values = entropy(&image, width, height, RADIUS_PX, 0..height);
            let started = std::time::Instant::now();
            let out = values.iter().zip(&image).map(|(&h, &level)| u8::from(neighbours.keep(h, level))).collect();
            println!("{}", started.elapsed().as_secs_f64());
            out
        }
        "dilate" => bytes(dilate(&mask(), &Kernel::ellipse(number()? as usize))),
        "erode" => bytes(erode(mask(), &Kernel::ellipse(number()? as usize))),
        "close" => bytes(close(mask(), &Kernel::ellipse(number()? as usize))),
        "clean" => bytes(clean(mask(), &Cleaning::default())),
        "holes" | "objects" => {
            let mut mask = mask();
            let bit = if step == "objects" { Bit::Set } else { Bit::Clear };
            flip_small(&mut mask, bit, number()?);
            bytes(mask)
        }
        other => return Err(format!("no step is called {other}").into()),
    };
    Ok(std::fs::write(output, out)?)
}
