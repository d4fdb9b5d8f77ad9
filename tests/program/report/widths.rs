//! The page in windows of any width: letters keep their size, nothing stands on the bars of length, and a click puts a
//! mark where it falls.

use super::{Sample, autoref, count, focus, number, stderr, tab_to_cards};
use crate::browser::{Browser, Page};
use serde_json::Value;

/// A sample with a point whose survey is a metre off: its mark is seen beside it, and proposed.
fn with_a_proposed_mark() -> (Sample, String) {
    let sample = Sample::new(|_| {}, |_| {});
    let name = sample.truth.visible().nth(4).expect("ten are visible").name.clone();
    let text = std::fs::read_to_string(sample.path("e6.geojson")).expect("the list");
    let mut list: Value = serde_json::from_str(&text).expect("GeoJSON");
    for feature in list["features"].as_array_mut().expect("features") {
        if feature["properties"]["name"] == name.as_str() {
            let easting = number(&feature["geometry"]["coordinates"][0]) + 1.0;
            feature["geometry"]["coordinates"][0] = easting.into();
        }
    }
    std::fs::write(sample.path("e6.geojson"), list.to_string()).expect("writable");
    let output = sample.run(&[]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    (sample, name)
}

/// Rectangles of the letters, the bars and the symbols of the overview, in pixels of the window.
const OVERVIEW: &str = "(() => { const all = (what) => [...document.querySelectorAll('#overview-figure > svg ' + what)] \
    .map((e) => { const r = e.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom, e.textContent]; }); \
    return { texts: all('text'), bars: all('path.bar'), symbols: all('g[transform]') }; })()";

#[test]
fn letters_have_one_size_and_the_bars_stand_free_in_any_window() {
    let (sample, _) = with_a_proposed_mark();
    let Some(mut browser) = Browser::start() else { return };
    browser.open(&sample.path("e6.report.html"));
    for width in [1280, 600, 400] {
        browser.widen(width);
        let drawn = browser.eval(OVERVIEW);
        let boxes = |what: &str| -> Vec<Vec<f64>> {
            let rows = drawn[what].as_array().expect("a list").iter();
            rows.map(|row| (0..4).map(|k| number(&row[k])).collect()).collect()
        };
        let (texts, bars, symbols) = (boxes("texts"), boxes("bars"), boxes("symbols"));
        assert!(texts.len() > 8 && bars.len() == 2 && symbols.len() > 8, "{width}: {drawn}");
        let height = |r: &Vec<f64>| r[3] - r[1];
        assert!(texts.iter().all(|r| (10.0..20.0).contains(&height(r))), "{width}: {drawn}");
        let meet = |a: &Vec<f64>, b: &Vec<f64>| a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
        for bar in &bars {
            assert!(!symbols.iter().any(|symbol| meet(bar, symbol)), "{width}: a symbol on a bar: {drawn}");
        }
        // Halos may touch: what counts is the letters, of which the box is a little larger.
        let core = |r: &Vec<f64>| vec![r[0] + 2.0, r[1] + 3.0, r[2] - 2.0, r[3] - 3.0];
        for (number, text) in texts.iter().enumerate() {
            let other = texts[..number].iter().find(|other| meet(&core(text), &core(other)));
            assert!(other.is_none(), "{width}: {text:?} on {other:?}: {drawn}");
        }
        let wide = browser.eval("document.documentElement.scrollWidth <= window.innerWidth");
        assert_eq!(wide, true, "the page is wider than {width}");
    }
    let words = browser.eval("document.getElementById('overview-figure').textContent");
    let words = words.as_str().expect("text");
    assert!(words.contains("arrows: ") && words.contains("enlarged ") && words.contains("proposed"), "{words}");
    let points = browser.eval("document.getElementById('points-table').textContent");
    assert!(!points.as_str().expect("text").contains("-0.0"), "{points}");
}

#[test]
fn a_click_puts_a_proposed_mark_where_it_falls() {
    let (sample, name) = with_a_proposed_mark();
    let Some(mut browser) = Browser::start() else { return };
    browser.open(&sample.path("e6.report.html"));
    tab_to_cards(&mut browser);
    browser.key("Home", false);
    focus(&mut browser, &name);
    let state = "document.querySelector('#editor dd').textContent";
    assert_eq!(browser.eval(state), "proposed");
    assert_eq!(count(&mut browser, "#editor svg.placing"), 1);
    // Five pixels right of and three below the middle of the picture.
    let at = browser.eval(
        "(() => { const box = document.querySelector('#editor svg.placing'), v = box.viewBox.baseVal; \
         box.scrollIntoView({ block: 'center' }); const x = v.x + v.width / 2 + 5, y = v.y + v.height / 2 + 3; \
         const p = new DOMPoint(x, y).matrixTransform(box.getScreenCTM()); return [x, y, p.x, p.y]; })()",
    );
    browser.click(number(&at[2]), number(&at[3]));
    assert_eq!(browser.eval(state), "in the fit, moved", "{at}");
    browser.eval("document.getElementById('save').click()");
    let patch = browser.download("e6.patch.json");
    let saved: Value = serde_json::from_slice(&std::fs::read(&patch).expect("the patch")).expect("JSON");
    let edit = &saved["edits"][0];
    assert_eq!((&edit["gcp"], &edit["action"]), (&name.as_str().into(), &"move".into()), "{saved}");
    for (axis, value) in [("x", &at[0]), ("y", &at[1])] {
        assert!((number(&edit[axis]) - number(value)).abs() < 0.2, "{saved} for {at}");
    }
    let json = sample.path("e6.autoref.json");
    let replayed =
        autoref(&["solve", json.to_str().expect("plain"), "--patch", patch.to_str().expect("plain"), "--quiet"]);
    assert_eq!(replayed.status.code(), Some(0), "{}", stderr(&replayed));
}
