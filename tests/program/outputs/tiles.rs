//! An image in tiles is one raster.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::{autoref, difference_px, is_valid_cog, refused, succeeded, transform_of};
use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_stream::result::RunResult;

/// Cuts an image into tiles with a world file each, as photogrammetry programs deliver them.
fn cut(image: &Path, folder: &Path, side: u64, whole: &GeoTransform) -> Vec<(PathBuf, GeoTransform)> {
    std::fs::create_dir(folder).expect("a folder");
    let source = gdal::Dataset::open(image).expect("opens");
    let (width, height) = source.raster_size();
    let (bands, driver) = (source.raster_count(), gdal::DriverManager::get_driver_by_name("GTiff").expect("there"));
    let mut tiles = Vec::new();
    for y in (0..height).step_by(side as usize) {
        for x in (0..width).step_by(side as usize) {
            let size = ((width - x).min(side as usize), (height - y).min(side as usize));
            let path = folder.join(format!("tile_{}_{}.tif", y / side as usize, x / side as usize));
            let tile = driver.create_with_band_type::<u8, _>(&path, size.0, size.1, bands).expect("created");
            for number in 1..=bands {
                let pixels = source
                    .rasterband(number)
                    .and_then(|band| band.read_as::<u8>((x as isize, y as isize), size, size, None))
                    .expect("read");
                let mut pixels = pixels;
                tile.rasterband(number).expect("there").write((0, 0), size, &mut pixels).expect("written");
            }
            tile.close().expect("written");
            let g = whole.0;
            let corner = whole.apply(PixelPoint { x: x as f64, y: y as f64 });
            let own = GeoTransform([corner.easting, g[1], g[2], corner.northing, g[4], g[5]]);
            let text = autoref_stream::georef::sidecar::world_file(&own);
            std::fs::write(path.with_extension("tfw"), text).expect("written");
            tiles.push((path, own));
        }
    }
    tiles
}

#[test]
fn tiles_with_world_files_are_one_raster() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let text = |path: PathBuf| path.to_str().expect("plain").to_string();
    let size =
        ["--size", "1500,1100", "--extent-m", "40,30", "--random-gcps", "12", "--visible", "10", "--gsd", "0.03"];
    let marks = ["--rotation", "6", "--mark-size", "14", "--seed", "5"];
    let (whole, list) = (text(at("e6.tif")), text(at("e6.geojson")));
    let mut synth = vec!["synth", &whole, "--write-gcps", &list];
    synth.extend(size.iter().chain(&marks));
    succeeded(&autoref(&synth));
    succeeded(&autoref(&[&whole, "--gcps", &list, "--quiet", "--no-report"]));
    let expected = RunResult::read(&at("e6.autoref.json")).expect("written").geotransform().expect("solved");
    // Local coordinates with another origin and unit.
    let local = GeoTransform([1000.0, 0.5, 0.0, 5000.0, 0.0, -0.5]);
    let tiles = cut(Path::new(&whole), &at("tiles"), 400, &local);
    let before: Vec<Vec<u8>> = tiles.iter().map(|(path, _)| std::fs::read(path).expect("there")).collect();
    let dir = text(at("tiles"));
    succeeded(&autoref(&[&dir, "--gcps", &list, "--quiet", "--no-report", "--prior", "none"]));
    let result = RunResult::read(&at("tiles.autoref.json")).expect("written");
    let image = result.image.as_ref().expect("described");
    assert_eq!((image.width, image.height), (1500, 1100));
    let solved = result.geotransform().expect("solved");
    assert_eq!(solved, expected, "tiles or not, the same answer");
    assert!(difference_px(&solved, &transform_of(&at("tiles.vrt"))) < 1e-6);
    assert_eq!(gdal::Dataset::open(at("tiles.vrt")).expect("opens").raster_size(), (1500, 1100));
    // Everything else from the result; world files and tags go to every tile.
    let json = text(at("tiles.autoref.json"));
    refused(&autoref(&["apply", &json, "--write", "world"]), &["tfw", "exists"]);
    succeeded(&autoref(&["apply", &json, "--write", "warp,gcps,tags,aux", "--quiet"]));
    is_valid_cog(&at("tiles.warp.tif"));
    for (path, own) in &tiles {
        let corner = local.invert(own.apply(PixelPoint { x: 0.0, y: 0.0 })).expect("not singular");
        let g = solved.0;
        let map = solved.apply(corner);
        let new = GeoTransform([map.easting, g[1], g[2], map.northing, g[4], g[5]]);
        assert!(difference_px(&new, &transform_of(path)) < 1e-6, "{}", path.display());
        std::fs::remove_file(autoref_stream::georef::sidecar::aux_path(path)).expect("written above");
        assert!(difference_px(&new, &transform_of(path)) < 1e-6, "{} by its tags", path.display());
    }
    // Rotated as they are now, the tiles still lie on one grid.
    assert_eq!(autoref_raster::size(&at("tiles"), 0).expect("a mosaic"), (1500, 1100));
    let names: Vec<String> = tiles.iter().map(|(path, _)| text(path.clone())).collect();
    let mut undo = vec!["undo", "--quiet"];
    undo.extend(names.iter().map(String::as_str));
    succeeded(&autoref(&undo));
    for ((path, _), before) in tiles.iter().zip(&before) {
        assert!(*before == std::fs::read(path).expect("there"), "{}", path.display());
    }
    tiles_that_do_not_fit(&at("tiles"), &at("tiles.txt"));
}

/// GDAL's own tiler cuts the image into 40 tiles of a tile map: the folder and its XML give the candidates of the one
/// file.
#[test]
fn forty_tiles_by_xml_are_the_image() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("plain").to_string();
    let (whole, list) = (at("e6.tif"), at("e6.geojson"));
    let shape =
        ["--size", "2048,1280", "--extent-m", "54,34", "--random-gcps", "14", "--visible", "11", "--gsd", "0.03"];
    let mut synth = vec!["synth", &whole, "--write-gcps", &list, "--georeferenced", "--seed", "8", "--mark-size", "14"];
    synth.extend(shape);
    succeeded(&autoref(&synth));
    let tiles = at("tiles");
    let tiler =
        Command::new("gdal2tiles.py").args(["-q", "-p", "raster", "-z", "3", "-w", "none", &whole, &tiles]).output();
    let Ok(cut) = tiler else {
        return crate::common::skipped("gdal2tiles.py is absent");
    };
    assert!(cut.status.success(), "{}", String::from_utf8_lossy(&cut.stderr));
    let xml = at("tiles/tilemapresource.xml");
    let detect = |image: &str| {
        let out = at("list.csv");
        succeeded(&autoref(&["detect", image, "-o", &out, "--overwrite"]));
        std::fs::read(&out).expect("written")
    };
    let one = detect(&whole);
    assert!(one.iter().filter(|byte| **byte == b'\n').count() > 8);
    assert!(detect(&tiles) == one && detect(&xml) == one, "other candidates by tiles");
    // Solved as one raster, where the XML says that it lies.
    succeeded(&autoref(&[&xml, "--gcps", &list, "--quiet", "--no-report"]));
    // A tile that is not there holds nothing; a description that is broken is named.
    std::fs::remove_file(at("tiles/3/2/3.png")).expect("there");
    assert_eq!(autoref_raster::size(Path::new(&tiles), 0).expect("a mosaic"), (2048, 1280));
    std::fs::write(&xml, "<TileMap><TileSets/></TileMap>").expect("written");
    refused(&autoref(&["detect", &tiles]), &["tilemapresource.xml", "TileFormat"]);
}

/// One clear line that names the tile.
fn tiles_that_do_not_fit(folder: &Path, list: &Path) {
    let line = || {
        let message = autoref_raster::size(folder, 0).expect_err("it does not fit").to_string();
        assert!(!message.contains('\n'), "{message}");
        message
    };
    let world = folder.join("tile_1_1.tfw");
    let original = std::fs::read_to_string(&world).expect("there");
    let mut lines: Vec<String> = original.lines().map(String::from).collect();
    lines[4] = (lines[4].parse::<f64>().expect("a number") + 0.2).to_string();
    std::fs::write(&world, lines.join("\n")).expect("written");
    let message = line();
    assert!(message.contains("tile_1_1.tif") && message.contains("no whole number"), "{message}");
    std::fs::remove_file(&world).expect("there");
    assert!(line().contains("no georeference of its own"), "{}", line());
    std::fs::write(&world, original).expect("written");
    std::fs::write(list, "# three of them\ntiles/tile_0_0.tif\n\ntiles/tile_0_1.tif\ntiles/tile_1_1.tif\n")
        .expect("written");
    assert_eq!(autoref_raster::size(list, 0).expect("a mosaic"), (800, 800));
    std::fs::write(list, "tiles/tile_0_0.tif\ntiles/none.tif\n").expect("written");
    let message = autoref_raster::size(list, 0).expect_err("absent").to_string();
    assert!(message.contains("line 2") && message.contains("none.tif"), "{message}");
    std::fs::remove_file(list).expect("there");
}
