//! Real browsers, as far as the tests of pages need them: Chromium over the DevTools protocol
//! (https://chromedevtools.github.io/devtools-protocol/) here, Firefox in a file of its own.

#![allow(dead_code)] // each test file uses its own part

pub mod firefox;

use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

const PATIENCE: Duration = Duration::from_secs(60);

/// A page in some browser.
pub trait Page {
    /// Opens a file and waits until it has loaded.
    fn open(&mut self, page: &Path);
    /// What the page said on the console, threw, or asked of the network besides itself and what it carries.
    fn complaints(&mut self) -> Vec<String>;
    /// The value of an expression in the page.
    fn eval(&mut self, expression: &str) -> Value;
    /// Presses and releases a key, as named by the UI Events specification ("a", "ArrowRight").
    fn key(&mut self, key: &str, shift: bool);
    /// Waits for a download of this name, JSON as all that the page saves.
    fn download(&mut self, name: &str) -> PathBuf;
}

/// Waits for a file that a browser saves, until it is whole.
fn awaited(path: &Path) -> PathBuf {
    let started = Instant::now();
    let whole = || std::fs::read(path).is_ok_and(|bytes| serde_json::from_slice::<Value>(&bytes).is_ok());
    while !whole() {
        assert!(started.elapsed() < PATIENCE, "{} was not saved", path.display());
        std::thread::sleep(Duration::from_millis(20));
    }
    path.to_path_buf()
}

/// One page in a browser of its own, which ends with it.
pub struct Browser {
    child: Child,
    socket: WebSocket<TcpStream>,
    session: String,
    next: u64,
    events: Vec<Value>,
    profile: tempfile::TempDir,
}

impl Browser {
    /// `None`, with a message, when there is no Chromium on the machine.
    pub fn start() -> Option<Browser> {
        let Some(program) = find() else {
            crate::common::skipped("no Chromium on this machine (PATH, AUTOREF_CHROMIUM, or Playwright's cache)");
            return None;
        };
        let profile = tempfile::tempdir().expect("a temporary folder");
        let child = Command::new(&program)
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-extensions"])
            .args(["--disable-background-networking", "--disable-dev-shm-usage", "--remote-debugging-port=0"])
            .args(["--window-size=1280,900", "--hide-scrollbars"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .env("TMPDIR", profile.path())
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the browser starts");
        let (port, path) = debugging_address(&profile.path().join("DevToolsActivePort"));
        let stream = TcpStream::connect(("127.0.0.1", port)).expect("the browser listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket takes a time limit");
        let (socket, _) = tungstenite::client(format!("ws://127.0.0.1:{port}{path}"), stream).expect("a websocket");
        let mut browser = Browser { child, socket, session: String::new(), next: 0, events: Vec::new(), profile };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"}));
        let attached =
            browser.call("Target.attachToTarget", json!({"targetId": target["targetId"].clone(), "flatten": true}));
        browser.session = attached["sessionId"].as_str().expect("a session").to_string();
        for domain in ["Page", "Runtime", "Log", "Network", "Accessibility"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        let downloads = browser.profile.path().join("downloads");
        std::fs::create_dir(&downloads).expect("a folder");
        let allow = json!({"behavior": "allow", "downloadPath": downloads.to_str().expect("plain")});
        let session = std::mem::take(&mut browser.session);
        browser.call("Browser.setDownloadBehavior", allow);
        browser.session = session;
        Some(browser)
    }

    /// The whole page as JPEG, at `scale` times its size.
    pub fn screenshot(&mut self, scale: f64) -> Vec<u8> {
        let height = self.eval("document.documentElement.scrollHeight");
        let clip = json!({"x": 0, "y": 0, "width": 1280, "height": height, "scale": scale});
        let answer = self.call(
            "Page.captureScreenshot",
            json!({"format": "jpeg", "quality": 60, "captureBeyondViewport": true, "clip": clip}),
        );
        decoded(answer["data"].as_str().expect("a picture"))
    }

    /// Makes the window so wide, in pixels.
    pub fn widen(&mut self, width: u32) {
        let size = json!({"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": false});
        self.call("Emulation.setDeviceMetricsOverride", size);
        // What watches for its size is told with the next frame.
        let frames = json!({"expression": "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))",
            "awaitPromise": true});
        self.call("Runtime.evaluate", frames);
    }

    /// Clicks in the window, pixels from its corner.
    pub fn click(&mut self, x: f64, y: f64) {
        for kind in ["mousePressed", "mouseReleased"] {
            let at = json!({"type": kind, "x": x, "y": y, "button": "left", "clickCount": 1});
            self.call("Input.dispatchMouseEvent", at);
        }
    }

    /// What the window shows, as JPEG.
    pub fn view(&mut self) -> Vec<u8> {
        let answer = self.call("Page.captureScreenshot", json!({"format": "jpeg", "quality": 70}));
        decoded(answer["data"].as_str().expect("a picture"))
    }

    /// The page as it prints.
    pub fn pdf(&mut self) -> Vec<u8> {
        let answer =
            self.call("Page.printToPDF", json!({"printBackground": true, "paperWidth": 8.27, "paperHeight": 11.69}));
        decoded(answer["data"].as_str().expect("a document"))
    }

    /// What a screen reader is told: role and name of every node that it does not ignore.
    pub fn spoken(&mut self) -> Vec<(String, String)> {
        let answer = self.call("Accessibility.getFullAXTree", json!({}));
        let text = |value: &Value| value["value"].as_str().unwrap_or_default().to_string();
        let nodes = answer["nodes"].as_array().expect("nodes").iter();
        nodes.filter(|node| node["ignored"] != true).map(|node| (text(&node["role"]), text(&node["name"]))).collect()
    }

    fn call(&mut self, method: &str, params: Value) -> Value {
        self.next += 1;
        let mut message = json!({"id": self.next, "method": method, "params": params});
        if !self.session.is_empty() {
            message["sessionId"] = self.session.clone().into();
        }
        self.socket.send(Message::text(message.to_string())).expect("the browser is there");
        loop {
            let answer = self.receive();
            if answer["id"] == self.next {
                assert!(answer.get("error").is_none(), "{method}: {answer}");
                return answer["result"].clone();
            }
        }
    }

    fn receive(&mut self) -> Value {
        loop {
            let message = self.socket.read().expect("the browser answers in time");
            if let Message::Text(text) = message {
                let value: Value = serde_json::from_str(&text).expect("DevTools speaks JSON");
                if value.get("method").is_some() {
                    self.events.push(value.clone());
                }
                return value;
            }
        }
    }
}

impl Page for Browser {
    fn open(&mut self, page: &Path) {
        self.events.clear();
        self.call("Page.navigate", json!({"url": format!("file://{}", page.display())}));
        while !self.events.iter().any(|e| e["method"] == "Page.loadEventFired") {
            self.receive();
        }
    }

    fn complaints(&mut self) -> Vec<String> {
        // A round trip brings what is on its way.
        self.eval("1");
        let seen = self.events.iter().filter_map(|event| {
            let params = &event["params"];
            match event["method"].as_str()? {
                "Runtime.exceptionThrown" | "Runtime.consoleAPICalled" | "Log.entryAdded" => Some(event.to_string()),
                "Network.requestWillBeSent" => {
                    let url = params["request"]["url"].as_str()?;
                    let own = ["data:", "blob:"].iter().any(|scheme| url.starts_with(scheme))
                        || params["type"] == "Document" && url.starts_with("file:");
                    (!own).then(|| url.to_string())
                }
                _ => None,
            }
        });
        seen.collect()
    }

    fn eval(&mut self, expression: &str) -> Value {
        let answer = self.call("Runtime.evaluate", json!({"expression": expression, "returnByValue": true}));
        assert!(answer.get("exceptionDetails").is_none(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    fn key(&mut self, key: &str, shift: bool) {
        let code = if key.len() == 1 { format!("Key{}", key.to_uppercase()) } else { key.to_string() };
        let virtual_key = match key {
            "ArrowLeft" => 37,
            "ArrowUp" => 38,
            "ArrowRight" => 39,
            "ArrowDown" => 40,
            "Tab" => 9,
            _ => u32::from(key.to_uppercase().as_bytes()[0]),
        };
        let mut down = json!({"type": "keyDown", "key": key, "code": code, "windowsVirtualKeyCode": virtual_key,
            "modifiers": if shift { 8 } else { 0 }});
        if key.len() == 1 {
            down["text"] = key.into();
        }
        self.call("Input.dispatchKeyEvent", down.clone());
        down["type"] = "keyUp".into();
        down.as_object_mut().expect("an object").remove("text");
        self.call("Input.dispatchKeyEvent", down);
    }

    fn download(&mut self, name: &str) -> PathBuf {
        awaited(&self.profile.path().join("downloads").join(name))
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn find() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("AUTOREF_CHROMIUM") {
        return Some(named.into());
    }
    let folders = std::env::var_os("PATH")?;
    let names = ["chromium", "chromium-browser", "google-chrome", "chrome-headless-shell"];
    let in_path = std::env::split_paths(&folders).flat_map(|folder| names.map(|name| folder.join(name)));
    let cache = std::env::home_dir().map(|home| home.join(".cache/ms-playwright"));
    let playwright = cache.and_then(|folder| std::fs::read_dir(folder).ok()).into_iter().flatten().flatten();
    let cached = playwright.flat_map(|entry| {
        ["chrome-linux/chrome", "chrome-linux/headless_shell"].map(|program| entry.path().join(program))
    });
    in_path.chain(cached).find(|path| path.is_file())
}

/// Port and path that the browser writes down once it listens.
fn debugging_address(file: &Path) -> (u16, String) {
    let started = Instant::now();
    loop {
        let text = std::fs::read_to_string(file).unwrap_or_default();
        let mut lines = text.lines();
        if let (Some(port), Some(path)) = (lines.next().and_then(|l| l.parse().ok()), lines.next()) {
            return (port, path.to_string());
        }
        assert!(started.elapsed() < PATIENCE, "the browser does not listen");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn decoded(text: &str) -> Vec<u8> {
    base64::prelude::Engine::decode(&base64::prelude::BASE64_STANDARD, text).expect("the browser writes base64")
}
