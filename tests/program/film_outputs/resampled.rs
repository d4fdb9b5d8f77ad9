//! The resampled frames against GDAL, masked, kept, and from scans in any layout.

use std::path::Path;
use std::process::Command;

use super::{Roll, autoref, pixels, plain, run, text};

/// Every kernel, at a pixel size below and above the scan's, against gdalwarp on the same grid.
#[test]
fn resampled_frames_are_those_of_gdalwarp() {
    if Command::new("gdalwarp").arg("--version").output().is_err() {
        crate::common::skipped("gdalwarp is absent");
        return;
    }
    let roll = Roll::new("wild-15-4", "150", &["--archive", "--seed", "2"]);
    let name = "wild-15-4-2";
    // A widened Lanczos is weighed otherwise by GDAL 3.6 (docs/limitations.md): not compared.
    for (kernel, pixel_mm) in [("bilinear", 0.14), ("cubic", 0.14), ("lanczos", 0.14), ("cubic", 0.375)] {
        let size = pixel_mm.to_string();
        let scan = roll.scans().join(format!("{name}.tif"));
        let out = roll.folder.path().join("out");
        let args = ["fiducials", plain(&scan), "--camera", "wild-15-4", "--quiet", "-o", plain(&out), "--resample"];
        let output = autoref(&[&args[..], &["--resample-mm", &size, "--kernel", kernel, "--overwrite"]].concat());
        assert!(output.status.code().is_some_and(|c| c < 2), "{}", String::from_utf8_lossy(&output.stderr));
        let frame = roll.frame(name);
        let inner = frame.interior.expect("solved");
        let (w, h, ours) = pixels(&roll.out(&format!("{name}.resampled.tif")));

        // The scan with the orientation as its geotransform (the camera's y runs up, as GDAL's).
        let g = inner.pixel_to_mm;
        let vrt = roll.folder.path().join("scan.vrt");
        let made = Command::new("gdal_translate").args(["-q", "-of", "VRT"]).arg(&scan).arg(&vrt).status();
        assert!(made.expect("gdal_translate").success());
        let transform = format!(
            "<GeoTransform>{:e}, {:e}, {:e}, {:e}, {:e}, {:e}</GeoTransform>",
            g[2], g[0], g[1], g[5], g[3], g[4]
        );
        let xml = text(&vrt).replacen("<VRTRasterBand", &(transform + "<VRTRasterBand"), 1);
        std::fs::write(&vrt, xml).expect("writable");
        let (low, _) = roll.camera.film_box();
        let (right, bottom) = (low[0] + w as f64 * pixel_mm, low[1] + h as f64 * pixel_mm);
        let extent = [low[0], -bottom, right, -low[1]].map(|v| format!("{v:.12}"));
        let warped = roll.folder.path().join("warped.tif");
        let scale = format!("{:.9}", inner.pixel_um / 1e3 / pixel_mm);
        let mut warp = Command::new("gdalwarp");
        warp.args(["-q", "-overwrite", "-et", "0", "-r", kernel, "-ts"]).args([w.to_string(), h.to_string()]);
        warp.args(["-wo", &format!("XSCALE={scale}"), "-wo", &format!("YSCALE={scale}"), "-te"]).args(&extent);
        assert!(warp.arg(&vrt).arg(&warped).status().expect("gdalwarp").success());
        let (gw, gh, theirs) = pixels(&warped);
        assert_eq!((gw, gh), (w, h));
        let (_, _, mask) = pixels(&roll.out(&format!("{name}.mask.tif")));
        // At the rim of the scan GDAL weighs differently.
        let rim = (8.0 * inner.pixel_um / 1e3 / pixel_mm).ceil() as usize + 8;
        let (mut count, mut off, mut worst) = (0usize, 0usize, 0.0f64);
        let white = if theirs.iter().any(|v| *v > 255.0) { 65_535.0 } else { 255.0 };
        for y in rim..h - rim {
            for x in rim..w - rim {
                let i = y * w + x;
                if mask[i] > 0.0 {
                    let difference = (ours[i] - theirs[i]).abs() * 255.0 / white;
                    count += 1;
                    off += usize::from(difference > 1.0);
                    worst = worst.max(difference);
                }
            }
        }
        println!("{kernel} {pixel_mm} mm: {count} pixels, {off} differ by more than 1 of 255, at most {worst:.2}");
        assert!(count > 100_000 && off * 10_000 < count && worst <= 3.0, "{kernel} {pixel_mm}");
    }
}

#[test]
fn resampled_frames_are_masked_kept_and_never_replaced_in_silence() {
    let roll = Roll::new("rmk-cross", "100", &[]);
    let name = "rmk-cross-1";
    let (image, mask) = (roll.out(&format!("{name}.resampled.tif")), roll.out(&format!("{name}.mask.tif")));
    let common = ["--resample", "--resample-mm", "0.1", "--mask-box", "-20,10,-5,30"];
    roll.fiducials(&common, 0);
    let (w, h, values) = pixels(&mask);
    let (low, high) = roll.camera.film_box();
    assert_eq!([w, h], [0, 1].map(|k| ((high[k] - low[k]) / 0.1).round() as usize));
    let marks = roll.camera.film_points();
    let inside = |[x, y]: [f64; 2]| {
        // The camera's y runs up.
        marks.iter().any(|m| (m[0] - x).hypot(m[1] - y) < 3.0)
            || (-20.0..=-5.0).contains(&x) && (-30.0..=-10.0).contains(&y)
    };
    let (mut terrain, mut wrong) = (0, 0);
    for (i, v) in values.iter().enumerate() {
        let at = [low[0] + ((i % w) as f64 + 0.5) * 0.1, low[1] + ((i / w) as f64 + 0.5) * 0.1];
        terrain += usize::from(*v > 0.0);
        wrong += usize::from((*v > 0.0) == inside(at));
    }
    assert!(wrong < 20 && terrain > w * h / 2, "{wrong} pixels of the mask are wrong, {terrain} terrain");
    let made = std::fs::read(&image).expect("there");
    let time = |p: &Path| std::fs::metadata(p).and_then(|m| m.modified()).expect("a time");
    let before = time(&image);
    roll.fiducials(&common, 0);
    assert_eq!(time(&image), before, "what is done is kept");
    // The scan was changed since: its frame is made again. Another pixel size, and somebody's own file are refused.
    let scan = std::fs::File::options().append(true).open(roll.scans().join(format!("{name}.tif"))).expect("a scan");
    let unchanged = scan.metadata().and_then(|m| m.modified()).expect("a time");
    scan.set_modified(unchanged + std::time::Duration::from_secs(7)).expect("writable");
    roll.fiducials(&common, 0);
    assert_ne!(std::fs::read(&image).expect("there"), made, "the description says of which scan it is");
    scan.set_modified(unchanged).expect("writable");
    roll.fiducials(&common, 0);
    assert_eq!(std::fs::read(&image).expect("there"), made);
    let said = roll.fiducials(&["--resample", "--resample-mm", "0.2"], 2);
    assert!(
        said.contains("resampled.tif") && said.contains("--overwrite") && said.trim_end().lines().count() == 1,
        "{said}"
    );
    assert_eq!(std::fs::read(&image).expect("there"), made);
    std::fs::write(&image, "mine").expect("writable");
    roll.fiducials(&common, 2);
    assert_eq!(text(&image), "mine");
    roll.fiducials(&[&common[..], &["--overwrite"]].concat(), 0);
    assert_eq!(std::fs::read(&image).expect("there"), made);
    let left: Vec<String> = std::fs::read_dir(roll.folder.path().join("out"))
        .expect("a folder")
        .map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned())
        .filter(|n| n.contains(".part") || n.contains(".before"))
        .collect();
    assert!(left.is_empty(), "{left:?}");
    for (extra, word) in
        [("--mask-box=1,2,3", "X,Y,X,Y"), ("--mask-marks-mm=-1", "between"), ("--lighting=roll", "--lighting frame")]
    {
        let said = roll.fiducials(&["--resample", "--resample-mm", "0.1", "--overwrite", extra], 2);
        assert!(said.contains(word), "{said}");
    }
}

/// JPEG, PNG and one compressed strip give what the same pixels give in tiles.
#[test]
fn scans_that_stream_give_the_same_frame_as_tiles() {
    let roll = Roll::new("rmk-cross", "110", &[]);
    let tiled = roll.scans().join("rmk-cross-1.tif");
    let other = roll.folder.path().join("other");
    std::fs::create_dir(&other).expect("writable");
    let resample = ["--resample", "--resample-mm", "0.11", "--overwrite"];
    roll.fiducials(&resample, 0);
    for (name, format, options) in
        [("a.png", "PNG", vec![]), ("b.tif", "GTiff", vec!["-co", "COMPRESS=DEFLATE", "-co", "BLOCKYSIZE=100000"])]
    {
        let to = other.join(name);
        let made =
            Command::new("gdal_translate").args(["-q", "-of", format]).args(&options).arg(&tiled).arg(&to).status();
        if !made.is_ok_and(|s| s.success()) {
            crate::common::skipped("gdal_translate is absent");
            return;
        }
        let out = roll.folder.path().join("other-out");
        let args = ["fiducials", plain(&to), "--camera", "rmk-cross", "--quiet", "-o", plain(&out)];
        run(&[&args[..], roll.lie(), &resample].concat(), 0);
        let ours = pixels(&out.join(format!("{}.resampled.tif", name.split('.').next().expect("a stem"))));
        assert!(ours == pixels(&roll.out("rmk-cross-1.resampled.tif")), "{name}");
    }
}
