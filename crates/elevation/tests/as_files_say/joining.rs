//! What sources of a mosaic say of their bands is compared, heeded and kept; and no tiling shows.

use std::path::{Path, PathBuf};

use autoref_elevation::derive;
use autoref_elevation::mosaic::{Choice, Made, MosaicJob, Surface};
use autoref_elevation::resample::Interpolation;
use gdal::raster::{ColorInterpretation, GdalType};
use gdal::spatial_ref::SpatialRef;
use gdal::{Dataset, DatasetOptions, GdalOpenFlags, Metadata};

use super::{create, put, read, resources};

const UTM: &str = "EPSG:32633";

/// A raster of one band with cells of a metre, from its left edge on; `nodata` is its value for nothing.
fn plate<T: GdalType + Copy>(
    path: &Path,
    x0: f64,
    size: (usize, usize),
    nodata: Option<f64>,
    value: impl Fn(usize, usize) -> T,
) -> PathBuf {
    let set = create::<T>(path, size, 1, UTM, [x0, 1.0, 0.0, 300.0, 0.0, -1.0]);
    set.rasterband(1).and_then(|mut band| band.set_no_data_value(nodata)).expect("labelled");
    put(&set, 1, (0..size.0 * size.1).map(|i| value(i % size.0, i / size.0)).collect());
    path.to_path_buf()
}

/// The sources joined, the first on top, and nothing else.
pub(super) fn job<'a>(inputs: &'a [PathBuf], out: &'a Path) -> MosaicJob<'a> {
    MosaicJob {
        inputs,
        out,
        choice: Choice::First,
        resolution: None,
        resampling: Interpolation::Bilinear,
        use_index: None,
        write_index: None,
        balance: None,
        balance_to: None,
        page: None,
        blend_px: 0,
        resources: resources(),
    }
}

fn made(job: &MosaicJob<'_>) -> Made {
    job.run().expect("joined")
}

fn refusal(job: &MosaicJob<'_>) -> String {
    job.run().expect_err("refused").to_string()
}

fn update(path: &Path) -> Dataset {
    let options = DatasetOptions { open_flags: GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() };
    Dataset::open_ex(path, options).expect("a raster")
}

fn in_unit(path: &Path, unit: &str) {
    autoref_raster::set_height_unit(path, &update(path), unit).expect("labelled");
}

/// A virtual raster of another one's bands, each with its own value for nothing.
fn with_nodata(path: &Path, of: &str, kind: &str, (width, height): (usize, usize), x0: f64, nodata: &[f64]) -> PathBuf {
    let band = |(number, nodata): (usize, &f64)| {
        format!(
            "<VRTRasterBand dataType=\"{kind}\" band=\"{number}\"><NoDataValue>{nodata}</NoDataValue><SimpleSource>\
             <SourceFilename relativeToVRT=\"1\">{of}</SourceFilename><SourceBand>{number}</SourceBand>\
             </SimpleSource></VRTRasterBand>"
        )
    };
    let bands: String = (1..).zip(nodata).map(band).collect();
    let text = format!(
        "<VRTDataset rasterXSize=\"{width}\" rasterYSize=\"{height}\"><SRS>{UTM}</SRS><GeoTransform>{x0},1,0,300,0,-1\
         </GeoTransform>{bands}</VRTDataset>"
    );
    std::fs::write(path, text).expect("writable");
    path.to_path_buf()
}

#[test]
fn units_are_compared_and_what_bands_say_is_kept() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let out = at("o.tif");
    let plain = |name: &str, x0: f64| plate(&at(name), x0, (20, 20), Some(-9999.0), |x, _| x as f32);
    let inputs = [plain("a.tif", 0.0), plain("b.tif", 15.0)];
    in_unit(&inputs[0], "ft");
    let noted = made(&job(&inputs, &out)).notes;
    assert!(noted.len() == 1 && noted[0].contains("b.tif") && noted[0].contains("ft"), "{noted:?}");
    assert_eq!(Dataset::open(&out).expect("a raster").rasterband(1).expect("a band").unit(), "ft");
    in_unit(&inputs[1], "m");
    let refused = refusal(&job(&inputs, &out));
    assert!(refused.contains("b.tif") && refused.contains("in m") && refused.contains("ft"), "{refused}");
    // `foot` is another name of it.
    in_unit(&inputs[1], "foot");
    assert!(made(&job(&inputs, &out)).notes.is_empty());

    let two = |name: &str, offset: f64| {
        let mut set = create::<i16>(&at(name), (20, 20), 2, UTM, [0.0, 1.0, 0.0, 300.0, 0.0, -1.0]);
        set.set_metadata_item("AREA_OR_POINT", "Point", "").expect("labelled");
        for (number, name) in [(1, "dem"), (2, "sigma")] {
            put(&set, number, vec![number as i16; 400]);
            set.rasterband(number).and_then(|mut band| band.set_description(name)).expect("labelled");
        }
        let band = set.rasterband(2);
        band.and_then(|mut band| band.set_scale(0.1).and_then(|()| band.set_offset(offset))).expect("labelled");
        at(name)
    };
    let inputs = [two("c.tif", 5.0), two("d.tif", 6.0)];
    made(&job(&inputs[..1], &out));
    let set = Dataset::open(&out).expect("a raster");
    let band = |number: usize| set.rasterband(number).expect("a band");
    assert_eq!((band(2).scale(), band(2).offset()), (Some(0.1), Some(5.0)));
    assert_eq!((band(1).scale().unwrap_or(1.0), band(1).offset().unwrap_or(0.0)), (1.0, 0.0));
    assert_eq!([1, 2].map(|number| band(number).description().expect("a name")), ["dem", "sigma"]);
    assert_eq!(set.metadata_item("AREA_OR_POINT", "").as_deref(), Some("Point"));
    assert_eq!(set.geo_transform().expect("a place"), [0.0, 1.0, 0.0, 300.0, 0.0, -1.0]);
    let refused = refusal(&job(&inputs, &out));
    assert!(refused.contains("d.tif") && refused.contains("band 2") && refused.contains("offset 6"), "{refused}");
}

/// Bytes are never -9999: what no source covers is masked. Each band has its own value for nothing.
#[test]
fn nodata_is_that_of_each_band_and_what_its_samples_can_hold() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let out = at("o.tif");
    let virtual_bytes = |name: &str, x0: f64| {
        plate(&at(&format!("{name}.tif")), x0, (10, 10), None, |_, _| 50u8);
        with_nodata(&at(&format!("{name}.vrt")), &format!("{name}.tif"), "Byte", (10, 10), x0, &[-9999.0])
    };
    let found = made(&job(&[virtual_bytes("a", 0.0), virtual_bytes("b", 20.0)], &out));
    let set = Dataset::open(&out).expect("a raster");
    let band = set.rasterband(1).expect("a band");
    assert_eq!((band.no_data_value(), found.filled_cells), (None, 200));
    let mask = band.open_mask_band().and_then(|mask| mask.read_as::<u8>((0, 0), (30, 1), (30, 1), None));
    let mask: Vec<u8> = mask.expect("a mask").data().to_vec();
    assert!(mask.iter().enumerate().all(|(x, there)| (*there > 0) != (10..20).contains(&x)), "{mask:?}");

    let set = create::<i16>(&at("p.tif"), (10, 10), 2, UTM, [0.0, 1.0, 0.0, 300.0, 0.0, -1.0]);
    let value = |nodata: i16, row: usize| move |i: usize| if i / 10 == row { nodata } else { 7 };
    put(&set, 1, (0..100).map(value(-9999, 0)).collect());
    put(&set, 2, (0..100).map(value(-32_768, 3)).collect());
    drop(set);
    let virtual_bands = with_nodata(&at("p.vrt"), "p.tif", "Int16", (10, 10), 0.0, &[-9999.0, -32_768.0]);
    made(&job(&[virtual_bands], &out));
    let second = read(&out, 2);
    let nodata = Dataset::open(&out).expect("a raster").rasterband(2).expect("a band").no_data_value();
    let is_void = |i: usize| Some(second[i]) == nodata;
    assert!((0..100).all(|i| is_void(i) == (i / 10 == 0 || i / 10 == 3)), "{second:?}");
}

/// Heights of zero beside a source whose zero is nothing.
#[test]
fn valid_heights_are_never_read_as_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let out = at("o.tif");
    let zero = plate(&at("zero.tif"), 0.0, (10, 10), Some(0.0), |x, _| if x < 2 { 0.0f32 } else { 5.0 });
    let sea = plate(&at("sea.tif"), 10.0, (10, 10), Some(-9999.0), |_, y| if y < 5 { 3.0f32 } else { 0.0 });
    let found = made(&job(&[zero.clone(), sea], &out));
    let nodata = Dataset::open(&out).expect("a raster").rasterband(1).expect("a band").no_data_value();
    let values = read(&out, 1);
    assert_eq!((found.filled_cells, values[9 * 20 + 15], nodata), (180, 0.0, Some(-9999.0)));
    assert_eq!(values.iter().filter(|v| Some(**v) != nodata).count(), 180);
    // A mean that meets the value for nothing is written beside it.
    let low = plate(&at("low.tif"), 0.0, (10, 10), Some(-9999.0), |_, _| -10_000.0f32);
    let high = plate(&at("high.tif"), 0.0, (10, 10), Some(-9999.0), |_, _| -9_998.0f32);
    let inputs = [low, high];
    let found = made(&MosaicJob { choice: Choice::Median, ..job(&inputs, &out) });
    let values = read(&out, 1);
    assert!(found.filled_cells == 100 && values.iter().all(|v| *v != -9999.0 && (v + 9999.0).abs() < 0.02));
}

#[test]
fn bands_that_mean_other_things_are_not_joined() {
    use ColorInterpretation::{AlphaBand, BlueBand, GrayIndex, GreenBand, RedBand, Undefined};
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let named = |name: &str, colours: &[ColorInterpretation], names: &[&str]| {
        let set = create::<u8>(&at(name), (10, 10), colours.len(), UTM, [0.0, 1.0, 0.0, 300.0, 0.0, -1.0]);
        for (number, colour) in (1..).zip(colours) {
            put(&set, number, vec![number as u8; 100]);
            let mut band = set.rasterband(number).expect("a band");
            let colour = ColorInterpretation::from_c_int(colour.c_int()).expect("a colour");
            band.set_color_interpretation(colour).expect("labelled");
            if let Some(name) = names.get(number - 1) {
                band.set_description(name).expect("labelled");
            }
        }
        at(name)
    };
    let out = at("o.tif");
    let rgb = named("rgb.tif", &[RedBand, GreenBand, BlueBand], &[]);
    let bgr = named("bgr.tif", &[BlueBand, GreenBand, RedBand], &[]);
    let refused = refusal(&job(&[rgb.clone(), bgr], &out));
    assert!(refused.contains("bgr.tif") && refused.contains("Blue") && refused.contains("-b 3"), "{refused}");
    let opaque = named("ga.tif", &[GrayIndex, AlphaBand], &[]);
    let other = named("gu.tif", &[GrayIndex, Undefined], &[]);
    assert!(refusal(&job(&[opaque, other], &out)).contains("Alpha"));
    let one = named("ds.tif", &[GrayIndex, Undefined], &["dem", "sigma"]);
    let turned = named("sd.tif", &[GrayIndex, Undefined], &["sigma", "dem"]);
    assert!(refusal(&job(&[one, turned], &out)).contains("sigma, dem"));
}

#[test]
fn tiles_on_both_sides_of_180_degrees_are_one_mosaic() {
    const WGS84: &str = "EPSG:4326";
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    // Two degrees on each side of the line, a tenth of a degree a cell, in either way of counting.
    let tile = |name: &str, west: f64, values: &dyn Fn(usize) -> f32| {
        let set = create::<f32>(&at(name), (20, 10), 1, WGS84, [west, 0.1, 0.0, 5.0, 0.0, -0.1]);
        put(&set, 1, (0..200).map(values).collect());
        at(name)
    };
    let column = |first: usize| move |i: usize| (first + i % 20) as f32;
    let west = tile("west.tif", 178.0, &column(0));
    for (name, from) in [("east.tif", -180.0), ("east_from_0.tif", 180.0)] {
        let east = tile(name, from, &column(20));
        for (inputs, x0) in [([west.clone(), east.clone()], 178.0), ([east, west.clone()], from - 2.0)] {
            let out = at("joined.tif");
            let made = made(&job(&inputs, &out));
            assert_eq!((made.width, made.height, made.filled_cells), (40, 10, 400), "{name}");
            assert!((made.geotransform[0] - x0).abs() < 1e-9, "{name}: {:?}", made.geotransform);
            let wanted: Vec<f64> = (0..400).map(|i| f64::from(i % 40)).collect();
            assert_eq!(read(&out, 1), wanted, "{name}");
        }
    }
    // Companions that count the other way lie on their sources all the same.
    let inputs = [west, tile("east.tif", -180.0, &column(20))];
    tile("west_cost.tif", -182.0, &|_| 1.0);
    tile("east_cost.tif", 180.0, &|_| 2.0);
    let out = at("cheapest.tif");
    let made = made(&MosaicJob { choice: Choice::Min("{stem}_cost.tif".into()), ..job(&inputs, &out) });
    assert_eq!((made.width, made.filled_cells), (40, 400));
}

/// A source around the Earth, and one over its end: the mosaic is one turn wide, and no ground is in it twice.
#[test]
fn sources_over_both_ends_of_the_earth_are_cut_to_one_turn() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let band = |name: &str, west: f64, degrees: usize, value: i16| {
        let set = create::<i16>(&at(name), (degrees, 10), 1, "EPSG:4326", [west, 1.0, 0.0, 5.0, 0.0, -1.0]);
        put(&set, 1, vec![value; 10 * degrees]);
        at(name)
    };
    let out = at("o.tif");
    let row = |out: &Path| read(out, 1)[..360].iter().map(|value| *value as i64).collect::<Vec<_>>();
    let (earth, over) = (band("earth.tif", -180.0, 360, 1), band("over.tif", 175.0, 10, 2));
    for (inputs, choice) in [
        ([earth.clone(), over.clone()], Choice::Last),
        ([over.clone(), earth.clone()], Choice::First),
        ([earth.clone(), over.clone()], Choice::Min("{stem}_cost.tif".into())),
    ] {
        band("earth_cost.tif", -180.0, 360, 2);
        band("over_cost.tif", 175.0, 10, 1);
        let found = made(&MosaicJob { choice, ..job(&inputs, &out) });
        assert_eq!((found.width, found.filled_cells), (360, 3600));
        assert!((found.geotransform[0] - -180.0).abs() < 1e-9, "{:?}", found.geotransform);
        let wanted: Vec<i64> = (0..360).map(|x| if (5..355).contains(&x) { 1 } else { 2 }).collect();
        assert_eq!(row(&out), wanted);
        assert!(found.notes.iter().any(|note| note.contains("from -180° to 180°")), "{:?}", found.notes);
    }
    let inputs = [earth.clone(), over];
    let refused = refusal(&MosaicJob { balance: Some(Surface::None), ..job(&inputs, &out) });
    assert!(refused.contains("over.tif") && refused.contains("projwin"), "{refused}");
    // Both around the Earth, counted from elsewhere, one by half a cell off the other's cells.
    let inputs = [band("from_0.tif", 0.5, 360, 3), earth];
    for choice in [Choice::First, Choice::Last, Choice::Median, Choice::Feather] {
        let wanted = if choice == Choice::First { vec![3; 360] } else { vec![1; 360] };
        let mixed = matches!(choice, Choice::Median | Choice::Feather);
        let found = made(&MosaicJob { choice, ..job(&inputs, &out) });
        assert_eq!((found.width, found.filled_cells), (360, 3600));
        assert!((found.geotransform[0] - 0.5).abs() < 1e-9, "{:?}", found.geotransform);
        if mixed {
            assert!(row(&out).iter().all(|value| (1..=3).contains(value)));
        } else {
            assert_eq!(row(&out), wanted);
        }
    }
}

#[test]
fn an_index_has_the_crs_of_its_sources() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let (out, index) = (at("o.tif"), at("index.tif"));
    let inputs =
        [plate(&at("a.tif"), 0.0, (20, 10), None, |_, _| 10u8), plate(&at("b.tif"), 10.0, (20, 10), None, |_, _| 20u8)];
    made(&MosaicJob { write_index: Some(&index), ..job(&inputs, &out) });
    made(&MosaicJob { use_index: Some(&index), ..job(&inputs, &out) });
    let mut set = update(&index);
    set.set_spatial_ref(&SpatialRef::from_definition("EPSG:32632").expect("PROJ knows it")).expect("set");
    set.close().expect("written");
    let refused = refusal(&MosaicJob { use_index: Some(&index), ..job(&inputs, &out) });
    assert!(refused.contains("index.tif") && refused.contains("another CRS"), "{refused}");
}

#[test]
fn dates_of_two_kinds_are_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let out = at("o.tif");
    let source = |name: &str| plate(&at(name), 0.0, (20, 10), None, |_, _| 10u8);
    let inputs = [source("a_20200101.tif"), source("undated.tif")];
    let found = made(&MosaicJob { choice: Choice::Newest, ..job(&inputs, &out) });
    assert!(found.notes.len() == 1 && found.notes[0].contains("dates") && found.notes[0].contains("undated.tif"));
    assert!(!found.notes[0].contains("a_2020"), "{:?}", found.notes);
    assert!(made(&job(&inputs, &out)).notes.is_empty());
    let inputs = [source("a_20200101.tif"), source("b_20210101.tif")];
    assert!(made(&MosaicJob { choice: Choice::Newest, ..job(&inputs, &out) }).notes.is_empty());
}

#[test]
fn a_companion_lies_on_its_source() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let out = at("o.tif");
    let inputs = [plate(&at("p.tif"), 0.0, (20, 10), None, |_, _| 10u8)];
    let job = MosaicJob { choice: Choice::Min("{stem}_r.tif".into()), ..job(&inputs, &out) };
    let companion = |x0: f64, epsg: &str| {
        let set = create::<f32>(&at("p_r.tif"), (20, 10), 1, epsg, [x0, 1.0, 0.0, 300.0, 0.0, -1.0]);
        put(&set, 1, vec![1.0; 200]);
    };
    companion(500.0, UTM);
    assert!(refusal(&job).contains("lies elsewhere"), "{}", refusal(&job));
    companion(0.0, "EPSG:32632");
    assert!(refusal(&job).contains("another CRS"), "{}", refusal(&job));
    companion(5.0, UTM);
    let found = made(&job);
    assert!(found.filled_cells == 150 && found.notes.len() == 1, "{found:?}");
    assert!(found.notes[0].contains("50 cells (25.0 %") && found.notes[0].contains("p_r.tif"), "{:?}", found.notes);
    companion(0.0, UTM);
    assert!(made(&job).notes.is_empty());
}

/// Cells coarser than the mosaic's, whose edges meet centres: any tile gives the same, and so do blended seams.
#[test]
fn coarse_cells_are_the_same_for_any_tile() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let first = plate(&at("t0.tif"), 0.0, (3, 3), None, |_, _| 7u8);
    let set = create::<u8>(&at("t1.tif"), (300, 290), 1, UTM, [5.0, 1.9, 0.0, 295.0, 0.0, -1.9]);
    put(&set, 1, (0..300 * 290).map(|i| ((i * 7919) % 251) as u8).collect());
    drop(set);
    let inputs = [first, at("t1.tif")];
    for (resampling, blend_px) in [(Interpolation::Nearest, 0), (Interpolation::Cubic, 0), (Interpolation::Bilinear, 9)]
    {
        let whole = |tile_px: u64| {
            let out = at(&format!("o{tile_px}.tif"));
            let resources = autoref_elevation::files::Resources { tile_px: Some(tile_px), ..resources() };
            made(&MosaicJob { resampling, blend_px, resources, ..job(&inputs, &out) });
            std::fs::read(&out).expect("there")
        };
        assert!(whole(16) == whole(1024), "{resampling:?} {blend_px}");
    }
}

/// A source that fills a triangle of its rectangle, and one that lies under all of it.
#[test]
fn nothing_jumps_at_the_edge_of_what_a_turned_source_holds() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let out = at("o.tif");
    let below = plate(&at("a.tif"), 0.0, (200, 200), Some(-9999.0), |_, _| 100.0f32);
    let turned =
        plate(&at("b.tif"), 50.0, (200, 200), Some(-9999.0), |x, y| if x + y < 200 { -9999.0 } else { 200.0f32 });
    let inputs = [below, turned];
    let step = |row: usize| {
        let line = &read(&out, 1)[row * 250..row * 250 + 190];
        line.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max)
    };
    let feathered = MosaicJob { choice: Choice::Feather, ..job(&inputs, &out) };
    made(&feathered);
    assert!(step(100) < 5.0, "{}", step(100));
    let whole = std::fs::read(&out).expect("there");
    let resources = autoref_elevation::files::Resources { tile_px: Some(16), threads: 1, ..resources() };
    made(&MosaicJob { resources, ..feathered });
    assert!(std::fs::read(&out).expect("there") == whole);
}

/// A seam is as wide as it is asked to be, and a source that is narrower than it is no step.
#[test]
fn seams_are_as_wide_as_asked_and_narrow_sources_no_steps() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let out = at("o.tif");
    let part = |name: &str, x0: f64, width: usize, value: f32| {
        plate(&at(name), x0, (width, 60), Some(-9999.0), move |_, _| value)
    };
    let two = [part("a.tif", 0.0, 100, 100.0), part("b.tif", 60.0, 100, 200.0)];
    let line = |inputs: &[PathBuf], blend_px: u64| {
        let found = made(&MosaicJob { blend_px, ..job(inputs, &out) });
        read(&out, 1)[30 * found.width as usize..31 * found.width as usize].to_vec()
    };
    // The seam lies at the end of the first source, which fades there: cells before it are mixed.
    let mixed = |blend_px: u64| {
        let nearest = [two[1].clone(), two[0].clone()];
        let job = MosaicJob { blend_px, choice: Choice::Nearest, ..job(&nearest, &out) };
        let found = made(&job);
        let row = &read(&out, 1)[30 * found.width as usize..31 * found.width as usize];
        row.iter().filter(|v| **v != 100.0 && **v != 200.0).count()
    };
    assert_eq!([0, 2, 3, 4, 10, 20].map(mixed), [0, 2, 4, 4, 10, 20]);
    let three = [part("c.tif", 0.0, 100, 100.0), part("d.tif", 90.0, 30, 200.0), part("e.tif", 110.0, 100, 100.0)];
    let row = line(&three, 120);
    let steps = row.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
    assert!(steps < 25.0 && row.iter().any(|v| *v > 150.0), "{steps}: {row:?}");
}

/// As with `gdalwarp`, within a cell of an edge or a hole too.
#[test]
fn cubic_gives_way_beside_holes_as_the_warper_has_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let out = at("o.tif");
    let rough = |x: usize, y: usize| {
        if (8..11).contains(&x) && (9..11).contains(&y) { -9999.0 } else { ((x * 31 + y * 17) % 23) as f32 }
    };
    let source = plate(&at("s.tif"), 0.37, (24, 20), Some(-9999.0), rough);
    update(&source).set_geo_transform(&[0.37, 1.0, 0.0, 300.41, 0.0, -1.0]).expect("a place");
    let phase = plate(&at("p.tif"), 100.0, (2, 2), Some(-9999.0), |_, _| 0.0f32);
    let found = made(&MosaicJob { resampling: Interpolation::Cubic, ..job(&[phase, source.clone()], &out) });
    let [x0, .., top, _, _] = found.geotransform;
    let (west, east) = (x0.to_string(), (x0 + found.width as f64).to_string());
    let (south, north) = ((top - found.height as f64).to_string(), top.to_string());
    let warped = at("w.tif");
    let options = ["-of", "GTiff", "-r", "cubic", "-tr", "1", "1", "-te", &west, &south, &east, &north];
    derive::warp(&source, &warped, &options).expect("warped");
    let (ours, theirs) = (read(&out, 1), read(&warped, 1));
    let width = found.width as usize;
    let mut compared = 0;
    for (i, (a, b)) in ours.iter().zip(&theirs).enumerate().filter(|(i, _)| i % width < 27) {
        if *a != -9999.0 && *b != -9999.0 {
            assert!((a - b).abs() < 1e-4, "{} {}: {a} {b}", i % width, i / width);
            compared += 1;
        }
    }
    assert!(compared > 440, "{compared}");
}

#[test]
fn of_equal_dates_the_first_wins_and_an_index_is_of_its_sources() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let (out, index) = (at("o.tif"), at("i.tif"));
    let dated = |name: &str, value: u8, date: &str| {
        let path = plate(&at(name), 0.0, (10, 10), None, move |_, _| value);
        update(&path).set_metadata_item("TIFFTAG_DATETIME", date, "").expect("labelled");
        path
    };
    let same = "2020:01:01 00:00:00";
    let inputs = [dated("o.tif_1.tif", 9, "2019:01:01 00:00:00"), dated("n1.tif", 10, same), dated("n2.tif", 20, same)];
    made(&MosaicJob { choice: Choice::Newest, write_index: Some(&index), ..job(&inputs, &out) });
    assert!(read(&out, 1).iter().all(|v| *v == 10.0) && read(&index, 1).iter().all(|v| *v == 2.0));
    for choice in [Choice::Median, Choice::Feather] {
        let refused = refusal(&MosaicJob { choice, write_index: Some(&index), ..job(&inputs, &out) });
        assert!(refused.contains("--write-index"), "{refused}");
    }
    let refused = refusal(&MosaicJob { use_index: Some(&index), ..job(&inputs[..1], &out) });
    assert!(refused.contains("i.tif") && refused.contains("source 2") && refused.contains("1 source"), "{refused}");
}

/// Cells that no file holds, and cells larger than a model.
#[test]
fn sides_of_cells_that_make_no_raster_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let inputs = [plate(&folder.path().join("a.tif"), 0.0, (50, 50), None, |x, _| x as f32)];
    let out = folder.path().join("o.tif");
    let refused = refusal(&MosaicJob { resolution: Some(1e-6), ..job(&inputs, &out) });
    assert!(refused.contains("--resolution") && !refused.contains(".part"), "{refused}");
    for side in [1e9, 1e-9] {
        let refused = derive::check_resolution(&inputs[0], side).expect_err("refused").to_string();
        assert!(refused.contains("a.tif") && refused.contains("1 × 1"), "{refused}");
    }
    assert!(derive::check_resolution(&inputs[0], 50.0).is_ok());
}

/// Corners and the end of a line are stations, once each.
#[test]
fn a_profile_has_the_corners_of_its_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let model = plate(&folder.path().join("a.tif"), 0.0, (50, 50), None, |x, _| x as f32);
    let line = [(1.0, 290.0), (5.5, 290.0), (5.5, 284.0), (9.0, 284.0)];
    let stations = autoref_elevation::profile::along(&[model], &line, Some(2.0)).expect("heights");
    let distances: Vec<f64> = stations.iter().map(|station| station.distance_m).collect();
    assert_eq!(distances, [0.0, 2.0, 4.0, 4.5, 6.0, 8.0, 10.0, 10.5, 12.0, 14.0]);
    assert_eq!((stations[3].x, stations[3].y, stations[9].x), (5.5, 290.0, 9.0));
}

/// Feet of the map beside heights of no unit are told, and no others.
#[test]
fn heights_that_are_taken_for_metres_are_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("f.tif");
    let set = create::<f32>(&path, (20, 20), 1, "EPSG:2264", [1_500_000.0, 10.0, 0.0, 600_000.0, 0.0, -10.0]);
    put(&set, 1, vec![7.0; 400]);
    drop(set);
    let doubt = |path: &Path| autoref_elevation::gradient::doubtful_unit(path).expect("a model");
    assert!(doubt(&path).is_some_and(|text| text.contains("f.tif") && text.contains("-units")));
    in_unit(&path, "ft");
    assert_eq!(doubt(&path), None);
}
