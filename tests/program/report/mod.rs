//! The report of a run, opened in a real browser where there is one: nothing fails, nothing is fetched, and what a
//! reviewer does by keyboard is what the replay of the patch gives.

mod page;
mod patches;
mod review;
mod widths;

use std::path::PathBuf;
use std::process::{Command, Output};

use crate::browser::{Browser, Page};
use autoref_synth::{self as synth, Compression, MarkSize, MarkStyle, SynthGcp, SynthSpec, Truth, Visible};
use serde_json::Value;

/// A name that would be markup if a page let it.
const EVIL: &str = "<script>document.title='owned'</script><b id=\"evil\">\"'&";

struct Sample {
    folder: tempfile::TempDir,
    truth: Truth,
}

impl Sample {
    /// An image of 2300 × 1700 px; `list` may change the list that the program is given.
    fn new(change: impl FnOnce(&mut SynthSpec), list: impl FnOnce(&mut Vec<SynthGcp>)) -> Sample {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut spec = SynthSpec {
            gcps: synth::random_gcps(14, 66.0, 48.0, 11),
            size_px: Some((2300, 1700)),
            rotation_deg: 7.5,
            visible: Visible::Random(10),
            displacement_px: 0.3,
            mark: MarkStyle { size: MarkSize::Px(14.0), ..MarkStyle::default() },
            ..SynthSpec::default()
        };
        spec.output.compression = Compression::Deflate;
        change(&mut spec);
        let truth = synth::write(&spec, &folder.path().join("e6.tif")).expect("a sample");
        let mut gcps = spec.gcps.clone();
        list(&mut gcps);
        synth::write_gcp_geojson(&folder.path().join("e6.geojson"), &gcps, Some(32632)).expect("a list");
        Sample { folder, truth }
    }

    /// Moves a visible point of the list so far to the east, metres; its name.
    fn survey_off(&self, nth: usize, by_m: f64) -> String {
        let wrong = self.truth.visible().nth(nth).expect("so many are visible").name.clone();
        let text = std::fs::read_to_string(self.path("e6.geojson")).expect("the list");
        let mut list: Value = serde_json::from_str(&text).expect("GeoJSON");
        for feature in list["features"].as_array_mut().expect("features") {
            if feature["properties"]["name"] == wrong.as_str() {
                let easting = number(&feature["geometry"]["coordinates"][0]) + by_m;
                feature["geometry"]["coordinates"][0] = easting.into();
            }
        }
        std::fs::write(self.path("e6.geojson"), list.to_string()).expect("writable");
        wrong
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, extra: &[&str]) -> Output {
        let (image, list) = (self.path("e6.tif"), self.path("e6.geojson"));
        let mut args = vec![image.to_str().expect("plain"), "--gcps", list.to_str().expect("plain"), "--quiet"];
        args.extend(extra);
        autoref(&args)
    }

    fn json(&self) -> Value {
        let text = std::fs::read_to_string(self.path("e6.autoref.json")).expect("the result was written");
        serde_json::from_str(&text).expect("one JSON document")
    }
}

fn autoref(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).args(args).output().expect("the program starts")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn count(browser: &mut dyn Page, selector: &str) -> u64 {
    let found = browser.eval(&format!("document.querySelectorAll({}).length", Value::from(selector)));
    found.as_u64().expect("a count")
}

/// Presses keys as a reviewer would: with the focus on a card of the named GCP.
fn focus(browser: &mut dyn Page, gcp: &str) {
    let find = format!(
        "[...document.querySelectorAll('button.card')].find(c => c.querySelector('.name').textContent === {})",
        Value::from(gcp)
    );
    for _ in 0..40 {
        if browser.eval(&format!("document.activeElement === {find}")) == Value::Bool(true) {
            return;
        }
        browser.key("ArrowRight", false);
    }
    panic!("the arrow keys do not reach {gcp}");
}

/// Tabs until a card has the focus, as one without a mouse does.
fn tab_to_cards(browser: &mut dyn Page) {
    for _ in 0..60 {
        browser.key("Tab", false);
        if browser.eval("document.activeElement.classList.contains('card')") == Value::Bool(true) {
            return;
        }
    }
    panic!("the Tab key does not reach the marks");
}

/// A sample with clutter, a name that would be markup, and the name of a visible point whose survey is 0.05 m = 1.7 px
/// off, found all the same: the wrong mark of the tests.
fn with_a_wrong_mark() -> (Sample, String) {
    let sample = Sample::new(|spec| spec.clutter = 30, |list| list[0].name = EVIL.into());
    let wrong = sample.survey_off(4, 0.05);
    (sample, wrong)
}

/// Every control has a name, the keyboard reaches all in the order of the page and shows where it is, text is legible.
fn accessible(browser: &mut Browser) {
    let spoken = browser.spoken();
    let named = [
        "button",
        "link",
        "checkbox",
        "combobox",
        "textbox",
        "table",
        "columnheader",
        "figure",
        "image",
        "img",
        "region",
    ];
    let nameless: Vec<_> =
        spoken.iter().filter(|(role, name)| named.contains(&role.as_str()) && name.trim().is_empty()).collect();
    assert!(nameless.is_empty(), "{nameless:?}");
    for (role, least) in [("button", 20), ("table", 1), ("columnheader", 14), ("status", 1), ("figure", 6)] {
        assert!(spoken.iter().filter(|(r, _)| r == role).count() >= least, "{role}");
    }

    // Once around with the Tab key, from the top.
    browser.eval("document.activeElement.blur()");
    browser.eval("window.seen = []");
    for stop in 0..60 {
        browser.key("Tab", false);
        let at = browser.eval(
            "(() => { const a = document.activeElement, s = getComputedStyle(a), last = window.seen[window.seen.length - 1]; \
             if (a === document.body || window.seen.includes(a)) return null; \
             const after = !last || Boolean(last.compareDocumentPosition(a) & Node.DOCUMENT_POSITION_FOLLOWING); window.seen.push(a); \
             return { after, outline: s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) >= 1, what: a.outerHTML.slice(0, 80) }; })()",
        );
        if at.is_null() {
            assert!(stop >= 20, "only {stop} stops");
            break;
        }
        assert!(at["after"] == true && at["outline"] == true, "{at}");
    }

    // WCAG 2.2, 1.4.3: relative luminance of the text against the nearest background that is painted.
    let faint = browser.eval(
        "(() => { const lin = (v) => (v /= 255) <= 0.04045 ? v / 12.92 : Math.pow((v + 0.055) / 1.055, 2.4); \
         const rgb = (c) => c.match(/[0-9.]+/g).map(Number); \
         const lum = (c) => 0.2126 * lin(c[0]) + 0.7152 * lin(c[1]) + 0.0722 * lin(c[2]); const out = []; \
         for (const e of document.querySelectorAll('body *')) { \
           const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim()); \
           if (!own || e.closest('svg, script, noscript, :disabled, [hidden]') || !e.getClientRects().length) continue; \
           let b = e, back = [255, 255, 255]; \
           while (b) { const c = rgb(getComputedStyle(b).backgroundColor); if (c.length < 4 || c[3] > 0) { back = c; break; } b = b.parentElement; } \
           const x = lum(rgb(getComputedStyle(e).color)), y = lum(back), ratio = (Math.max(x, y) + 0.05) / (Math.min(x, y) + 0.05); \
           if (ratio < 4.5) out.push(ratio.toFixed(2) + ' ' + e.outerHTML.slice(0, 80)); } return out; })()",
    );
    assert_eq!(faint, Value::Array(Vec::new()), "text too faint");
}
