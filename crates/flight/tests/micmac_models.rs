//! MicMac's models of distortion against their formulas as the articles and MicMac's sources have them: plain sums of
//! x and y here, polynomials with numbered terms in the crate.

use autoref_flight::camera::{Camera, SizeOf};
use autoref_flight::read::{self, micmac};

const F: f64 = 3300.0;
const PP: [f64; 2] = [2010.0, 1485.0];
/// Directions within the frame, at Z = 1.
const DIRECTIONS: [[f64; 2]; 5] = [[0.0, 0.0], [0.5, -0.4], [-0.55, 0.42], [0.2, 0.35], [-0.4, -0.1]];

fn ideal([x, y]: [f64; 2]) -> [f64; 2] {
    [PP[0] + F * x, PP[1] + F * y]
}

/// Numbers about zero, always the same.
fn drawn(count: usize, size: impl Fn(usize) -> f64) -> Vec<f64> {
    (0..count).map(|k| (1.0 + 7.3 * k as f64).sin() * size(k)).collect()
}

fn elements(name: &str, values: &[f64]) -> String {
    values.iter().map(|v| format!("<{name}>{v}</{name}>")).collect()
}

fn model(kind: &str, parameters: &[f64], states: &[f64]) -> String {
    let numbers = elements("Params", parameters) + &elements("Etats", states);
    format!("<CalibDistortion><ModUnif><TypeModele>{kind}</TypeModele>{numbers}</ModUnif></CalibDistortion>")
}

fn radial(centre: [f64; 2], coefficients: &[f64]) -> String {
    let terms = elements("CoeffDist", coefficients);
    format!("<CalibDistortion><ModRad><CDist>{} {}</CDist>{terms}</ModRad></CalibDistortion>", centre[0], centre[1])
}

fn calibration(known: &str, distortions: &str) -> String {
    let known = if known.is_empty() { String::new() } else { format!("<KnownConv>{known}</KnownConv>") };
    format!(
        "<ExportAPERO><CalibrationInternConique>{known}<PP>{} {}</PP><F>{F}</F><SzIm>4000 3000</SzIm>{distortions}\
         </CalibrationInternConique></ExportAPERO>",
        PP[0], PP[1]
    )
}

fn read_camera(text: &str) -> autoref_flight::Result<Camera> {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("AutoCal.xml");
    std::fs::write(&file, text).expect("written");
    micmac::read_camera(&file)
}

const TO_IMAGE: &str = "eConvApero_DistM2C";
const FROM_IMAGE: &str = "eConvApero_DistC2M";

/// A distortion, as the file has it and as its formula.
type Stated = (String, Box<dyn Fn([f64; 2]) -> [f64; 2]>);

fn ebner() -> Stated {
    let degrees = [1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4];
    let v = drawn(12, |k| 2e-3 / 4000_f64.powi(degrees[k] - 1));
    let text = model("eModeleEbner", &v, &[]);
    // The base is 0.4 of the shorter side where none is stated.
    let q = 2.0 / 3.0 * 1200.0 * 1200.0;
    let formula = move |[x, y]: [f64; 2]| {
        let (k, l) = (x * x - q, y * y - q);
        let u = v[0] * x + v[1] * y - 2.0 * v[2] * k + v[3] * x * y + v[4] * l;
        let w = -v[0] * y + v[1] * x + v[2] * x * y - 2.0 * v[3] * l + v[5] * k;
        [x + u + v[6] * x * l + v[8] * y * k + v[10] * k * l, y + w + v[7] * y * k + v[9] * x * l + v[11] * k * l]
    };
    (text, Box::new(formula))
}

fn brown() -> Stated {
    let degrees = [1, 1, 2, 2, 3, 3, 4, 2, 2, 3, 3, 4, 4, 3];
    let v = drawn(14, |k| 2e-3 / 4000_f64.powi(degrees[k] - 1));
    let text = model("eModeleDCBrown", &v, &[3000.0]);
    let formula = move |[x, y]: [f64; 2]| {
        let (x2, y2) = (x * x, y * y);
        let along = v[12] / 3000.0 * x2 * y2 + v[13] * (x2 + y2);
        let u = v[0] * x + v[1] * y + v[2] * x * y + v[3] * y2 + v[4] * x2 * y + v[5] * x * y2 + v[6] * x2 * y2;
        let w = v[7] * x * y + v[8] * x2 + v[9] * x2 * y + v[10] * x * y2 + v[11] * x2 * y2;
        [x + u + along * x, y + w + along * y]
    };
    (text, Box::new(formula))
}

fn low(v: &[f64], x: f64, y: f64) -> [f64; 2] {
    [
        x + v[0] * x + v[1] * y - 2.0 * v[2] * x * x + v[3] * x * y + v[4] * y * y,
        y - v[0] * y + v[1] * x + v[2] * x * y - 2.0 * v[3] * y * y + v[5] * x * x,
    ]
}

fn cubic() -> Stated {
    let v = drawn(14, |_| 2e-3);
    let text = model("eModelePolyDeg3", &v, &[2500.0, 1990.0, 1510.0]);
    let formula = move |[x, y]: [f64; 2]| {
        let (x, y) = ((x - 1990.0) / 2500.0, (y - 1510.0) / 2500.0);
        let [u, w] = low(&v, x, y);
        let high = |c: &[f64]| c[0] * x * x * x + c[1] * x * x * y + c[2] * x * y * y + c[3] * y * y * y;
        [1990.0 + 2500.0 * (u + high(&v[6..10])), 1510.0 + 2500.0 * (w + high(&v[10..14]))]
    };
    (text, Box::new(formula))
}

fn four() -> Stated {
    let mut v = drawn(13, |_| 2e-3);
    (v[6], v[7]) = (0.04, -0.03);
    let text = model("eModeleRadFour11x2", &v, &[]);
    let formula = move |[x, y]: [f64; 2]| {
        let (x, y) = ((x - 2000.0) / 2500.0, (y - 1500.0) / 2500.0);
        let [u, w] = low(&v, x, y);
        let (a, b) = (x - v[6], y - v[7]);
        let r2 = a * a + b * b;
        let radial: f64 = (0..5).map(|k| v[8 + k] * r2.powi(k as i32 + 1)).sum();
        [2000.0 + 2500.0 * (u + a * radial), 1500.0 + 2500.0 * (w + b * radial)]
    };
    (text, Box::new(formula))
}

/// Distance from the centre by the angle off the axis.
type Law = fn(f64) -> f64;

fn fisheye(kind: &'static str, law: Law) -> Stated {
    let mut v = drawn(50, |k| if (2..12).contains(&k) { 0.01 * 0.6_f64.powi(k as i32) } else { 1e-3 });
    (v[0], v[1]) = (2020.0, 1470.0);
    let text = model(kind, &v, &[3000.0]);
    let formula = move |[x, y]: [f64; 2]| {
        let (a, b) = ((x - 2020.0) / 3000.0, (y - 1470.0) / 3000.0);
        let ratio = law(a.hypot(b).atan()) / a.hypot(b);
        let (x, y) = (a * ratio, b * ratio);
        let r2 = x * x + y * y;
        let radial: f64 = (0..10).map(|k| v[2 + k] * r2.powi(k as i32 + 1)).sum();
        let (mut u, mut w) = (x + x * radial, y + y * radial);
        for k in 0..5 {
            let (p, q, n) = (v[12 + 2 * k], v[13 + 2 * k], 2.0 * (k as f64 + 1.0));
            u += r2.powi(k as i32) * (p * (r2 + n * x * x) + q * n * x * y);
            w += r2.powi(k as i32) * (p * n * x * y + q * (r2 + n * y * y));
        }
        u += v[22] * x + v[23] * y;
        w += v[23] * x;
        // The numbers of x's and of y's terms in the order in which MicMac counts them.
        let in_x = [(25, 2, 1), (27, 1, 2), (29, 0, 3), (32, 3, 1), (34, 2, 2), (36, 1, 3), (38, 0, 4)];
        let in_y = [(24, 3, 0), (26, 2, 1), (28, 1, 2), (30, 0, 3), (31, 4, 0), (33, 3, 1), (35, 2, 2), (37, 1, 3)];
        let fifth_x = [(40, 4, 1), (42, 3, 2), (44, 2, 3), (46, 1, 4), (48, 0, 5)];
        let fifth_y = [(39, 5, 0), (41, 4, 1), (43, 3, 2), (45, 2, 3), (47, 1, 4), (49, 0, 5)];
        let sum = |terms: &[(usize, i32, i32)]| -> f64 {
            terms.iter().map(|(at, i, j)| v[*at] * x.powi(*i) * y.powi(*j)).sum()
        };
        u += sum(&in_x) + sum(&fifth_x);
        w += sum(&in_y) + sum(&fifth_y);
        [2020.0 + 3000.0 * u, 1470.0 + 3000.0 * w]
    };
    (text, Box::new(formula))
}

fn seven() -> Stated {
    let v = drawn(7, |k| 0.05 / F.powi(2 * k as i32 + 2));
    let text = radial([2030.0, 1500.0], &v);
    let formula = move |[x, y]: [f64; 2]| {
        let (a, b) = (x - 2030.0, y - 1500.0);
        let r2 = a * a + b * b;
        let sum: f64 = (0..7).map(|k| v[k] * r2.powi(k as i32 + 1)).sum();
        [x + a * sum, y + b * sum]
    };
    (text, Box::new(formula))
}

fn polynomials() -> [Stated; 5] {
    [ebner(), brown(), cubic(), four(), seven()]
}

fn near(at: [f64; 2], wanted: [f64; 2], what: &str) {
    assert!((at[0] - wanted[0]).hypot(at[1] - wanted[1]) < 1e-8, "{what}: {at:?} {wanted:?}");
}

fn see(camera: &Camera, [x, y]: [f64; 2]) -> [f64; 2] {
    let at = camera.project([x, y, 1.0]).expect("in front");
    let [a, b, c] = camera.ray(at).expect("a ray");
    assert!((a / c - x).hypot(b / c - y) < 1e-8, "the ray of {at:?}");
    at
}

#[test]
fn every_model_is_its_formula() {
    let fisheyes = [
        fisheye("eModele_FishEye_10_5_5", |angle| angle),
        fisheye("eModele_EquiSolid_FishEye_10_5_5", |angle| 2.0 * (angle / 2.0).sin()),
        fisheye("eModele_Stereographik_FishEye_10_5_5", |angle| 2.0 * (angle / 2.0).tan()),
    ];
    for (text, formula) in polynomials().into_iter().chain(fisheyes) {
        let camera = read_camera(&calibration(TO_IMAGE, &text)).expect(&text);
        for direction in DIRECTIONS {
            near(see(&camera, direction), formula(ideal(direction)), &text);
        }
    }
}

#[test]
fn distortions_from_the_image_are_undone() {
    for (text, formula) in polynomials() {
        let camera = read_camera(&calibration(FROM_IMAGE, &text)).expect(&text);
        for direction in DIRECTIONS {
            near(formula(see(&camera, direction)), ideal(direction), &text);
        }
    }
}

/// The last of the list is applied first; each but that may be stated the other way.
#[test]
fn a_chain_is_applied_from_its_end() {
    let lens_of = |v: [f64; 2]| {
        let text = radial([2000.0, 1500.0], &v);
        let formula = move |[x, y]: [f64; 2]| {
            let (a, b) = (x - 2000.0, y - 1500.0);
            let r2 = a * a + b * b;
            let sum = v[0] * r2 + v[1] * r2 * r2;
            [x + a * sum, y + b * sum]
        };
        (text, formula)
    };
    let (first, second) = (lens_of([-8e-9, 3e-16]), lens_of([5e-9, -2e-16]));
    let (bent, through) = ebner();
    let chain = |texts: [&str; 3]| calibration(TO_IMAGE, &texts.concat());
    let camera = read_camera(&chain([&first.0, &bent, &second.0])).expect("a chain");
    assert_eq!((camera.before.len(), camera.after.len()), (0, 2), "the lens that comes first can be adjusted");
    for direction in DIRECTIONS {
        near(see(&camera, direction), first.1(through(second.1(ideal(direction)))), "lens, Ebner, lens");
    }
    let senses = "<ComplIsC2M>true</ComplIsC2M>";
    let camera = read_camera(&calibration(TO_IMAGE, &[senses, &bent, &first.0].concat())).expect("a chain");
    for direction in DIRECTIONS {
        near(through(see(&camera, direction)), first.1(ideal(direction)), "Ebner undone");
    }
}

/// A scan that is turned, sheared or mirrored against the film: the camera is the film's, its pixels are the scan's.
#[test]
fn scans_may_lie_as_they_like() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("written");
    let (text, formula) = cubic();
    let pair = |[x, y]: [f64; 2]| format!("{x} {y}");
    let scans = [
        [[60.0, -20.0], [2.0, 0.01], [-0.02, 2.01]],
        [[6100.0, 5.0], [0.0, 2.0], [-2.0, 0.0]],
        [[8100.0, 6000.0], [-2.0, 0.0], [0.0, -2.0]],
        [[0.0, 6000.0], [2.0, 0.0], [0.0, -2.0]],
    ];
    let global = [[3.0, -4.0], [1.01, 0.002], [0.003, 0.99]];
    let through = |[i00, v10, v01]: [[f64; 2]; 3], [x, y]: [f64; 2]| {
        [i00[0] + v10[0] * x + v01[0] * y, i00[1] + v10[1] * x + v01[1] * y]
    };
    let affinity = |name: &str, [a, b, c]: [[f64; 2]; 3]| {
        format!("<{name}><I00>{}</I00><V10>{}</V10><V01>{}</V01></{name}>", pair(a), pair(b), pair(c))
    };
    for (with_global, scan) in [false, true].into_iter().flat_map(|g| scans.map(|s| (g, s))) {
        let stated = format!("<OrIntGlob>{}<C2M>false</C2M></OrIntGlob>", affinity("Affinite", global));
        let more = if with_global { stated + &text } else { text.clone() };
        write("AutoCal.xml", &calibration(TO_IMAGE, &more));
        write(
            "Orientation-a.tif.xml",
            &format!(
                "<OrientationConique>{}<FileInterne>AutoCal.xml</FileInterne><Externe><Centre>1 2 3</Centre>\
                 <ParamRotation><CodageAngulaire>10 20 30</CodageAngulaire></ParamRotation></Externe>\
                 </OrientationConique>",
                affinity("OrIntImaM2C", scan)
            ),
        );
        let block = read::reconstruction(folder.path()).expect("a block");
        let camera = &block.cameras[0];
        assert_eq!(camera.size_of, if with_global { SizeOf::Image } else { SizeOf::Film });
        for direction in DIRECTIONS {
            let mut wanted = through(scan, formula(ideal(direction)));
            if with_global {
                wanted = through(global, wanted);
            }
            near(see(camera, direction), wanted, &format!("{scan:?}"));
        }
    }
}

/// MMVII adds all terms up about the principal point.
#[test]
fn terms_of_mmvii_are_one_sum() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("Calib-PerspCentral-a.xml");
    let write = |projection: &str, terms: &str| {
        let text = format!(
            "<Root><Data><InternalCalibration><Name>\"a\"</Name><PixelFrame><NbPix>4000 3000</NbPix></PixelFrame>\
             <Projection>\"{projection}\"</Projection><PerfectProj><F>{F}</F><PP>{} {}</PP></PerfectProj><Distorsion>\
             <Radial>{terms}</Radial></Distorsion></InternalCalibration></Data></Root>",
            PP[0], PP[1]
        );
        std::fs::write(&file, text).expect("written");
        micmac::read_camera(&file)
    };
    let terms =
        "<K1>-0.1</K1><p1>1e-3</p1><p4>2e-3</p4><b2>-1e-3</b2><x_1_2>0.01</x_1_2><y_3_0>-0.02</y_3_0><y_0_2>0</y_0_2>";
    let plane: [(&str, Law); 4] = [
        ("Stenope", f64::tan),
        ("FE_EquiSolid", |angle| 2.0 * (angle / 2.0).sin()),
        ("StereroGraphik", |angle| 2.0 * (angle / 2.0).tan()),
        ("OrthoGraphik", f64::sin),
    ];
    for (projection, law) in plane {
        let camera = write(projection, terms).expect(projection);
        for [x, y] in DIRECTIONS {
            let r = f64::hypot(x, y);
            let ratio = if r > 0.0 { law(r.atan()) / r } else { 1.0 };
            let (a, b) = (x * ratio, y * ratio);
            let r2 = a * a + b * b;
            // p4 is of a centre displaced in y, of (x, y) r⁴.
            let u =
                a - 0.1 * a * r2 + 1e-3 * (r2 + 2.0 * a * a) + 2e-3 * 4.0 * a * b * r2 - 1e-3 * b + 0.01 * a * b * b;
            let w = b - 0.1 * b * r2 + 1e-3 * 2.0 * a * b + 2e-3 * (r2 * r2 + 4.0 * b * b * r2) - 0.02 * a * a * a;
            near(see(&camera, [x, y]), ideal([u, w]), projection);
        }
    }
    let round = write("EquiRect", "<K1>0</K1>").expect("a panorama");
    let behind = round.project([1.0, 0.5, -1.0]).expect("all round");
    near(behind, ideal([0.75 * std::f64::consts::PI, (0.5_f64 / 1.5).asin()]), "EquiRect");
    let ray = round.ray(behind).expect("a ray");
    assert!((ray[0] - 1.0 / 1.5).abs() < 1e-12 && (ray[2] + 1.0 / 1.5).abs() < 1e-12, "{ray:?}");
    for (projection, terms, word) in [("Mercator", "", "<Projection>"), ("Stenope", "<q1>1</q1>", "<q1>")] {
        let said = write(projection, terms).expect_err("refused").to_string();
        assert!(said.contains("Calib-PerspCentral-a.xml") && said.contains(word), "{said}");
    }
}

#[test]
fn what_no_camera_holds_is_refused_by_name() {
    let many = drawn(13, |_| 1.0);
    let more_radial = radial(PP, &drawn(21, |_| 1e-30));
    for (known, text, word) in [
        (TO_IMAGE, model("eModeleEbner", &many, &[]), "`eModeleEbner` has 12 <Params> and 1 <Etats>"),
        (TO_IMAGE, model("eModeleEbner", &[], &[-1.0]), "a positive number is expected"),
        (TO_IMAGE, model("eModeleNew", &[], &[]), "`eModeleNew` is not read; calibrate with FraserBasic"),
        (TO_IMAGE, model("", &[], &[]), "there is no <TypeModele>"),
        (TO_IMAGE, more_radial, "more than 20 <CoeffDist>"),
        (TO_IMAGE, "<CalibDistortion><ModGrid/></CalibDistortion>".into(), "<ModGrid>"),
        (TO_IMAGE, "<ParamAF>0.1</ParamAF><ParamAF>0</ParamAF>".into(), "<ParamAF>"),
        (TO_IMAGE, "<CorrectionRefractionAPosteriori/>".into(), "<CorrectionRefractionAPosteriori>"),
        ("eConvInconnue", String::new(), "<KnownConv>"),
        ("", radial(PP, &[1e-9]), "add <KnownConv>eConvApero_DistM2C</KnownConv>"),
        (FROM_IMAGE, model("eModele_FishEye_10_5_5", &[], &[]), "write it with eConvApero_DistM2C"),
    ] {
        let said = read_camera(&calibration(known, &text)).map(|_| ()).expect_err(word).to_string();
        assert!(said.contains("AutoCal.xml: <") && said.contains(word), "{said}");
    }
    let plain = read_camera(&calibration("", &radial(PP, &[0.0]))).expect("no sense is needed where nothing moves");
    assert!(!plain.has_plane_maps());
}
