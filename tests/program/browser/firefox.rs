//! A real Firefox over WebDriver BiDi (https://w3c.github.io/webdriver-bidi/), as far as the tests of pages need it.

use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

use super::{PATIENCE, Page, awaited};

/// One page in a Firefox of its own, which ends with it.
pub struct Firefox {
    child: Child,
    socket: WebSocket<TcpStream>,
    context: String,
    next: u64,
    events: Vec<Value>,
    profile: tempfile::TempDir,
}

impl Firefox {
    /// `None`, with a message, when there is no Firefox on the machine.
    pub fn start() -> Option<Firefox> {
        let Some(program) = find() else {
            crate::common::skipped("no Firefox on this machine (PATH or AUTOREF_FIREFOX)");
            return None;
        };
        let profile = tempfile::tempdir().expect("a temporary folder");
        let downloads = profile.path().join("downloads");
        std::fs::create_dir(&downloads).expect("a folder");
        let preferences = [
            r#"user_pref("browser.download.folderList", 2);"#.to_string(),
            format!(r#"user_pref("browser.download.dir", "{}");"#, downloads.display()),
            r#"user_pref("browser.download.alwaysOpenPanel", false);"#.into(),
            r#"user_pref("browser.helperApps.neverAsk.saveToDisk", "application/json");"#.into(),
            r#"user_pref("datareporting.policy.dataSubmissionEnabled", false);"#.into(),
        ];
        std::fs::write(profile.path().join("user.js"), preferences.join("\n")).expect("writable");
        let child = Command::new(&program)
            .args(["--headless", "--remote-debugging-port=0", "--width=1280", "--height=900", "--profile"])
            .arg(profile.path())
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the browser starts");
        let port = debugging_port(&profile.path().join("WebDriverBiDiServer.json"));
        let stream = TcpStream::connect(("127.0.0.1", port)).expect("the browser listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket takes a time limit");
        let (socket, _) = tungstenite::client(format!("ws://127.0.0.1:{port}/session"), stream).expect("a websocket");
        let mut browser = Firefox { child, socket, context: String::new(), next: 0, events: Vec::new(), profile };
        browser.call("session.new", json!({"capabilities": {}}));
        let tree = browser.call("browsingContext.getTree", json!({}));
        browser.context = tree["contexts"][0]["context"].as_str().expect("a tab").to_string();
        browser.call("session.subscribe", json!({"events": ["log.entryAdded", "network.beforeRequestSent"]}));
        Some(browser)
    }

    fn call(&mut self, method: &str, params: Value) -> Value {
        self.next += 1;
        let message = json!({"id": self.next, "method": method, "params": params});
        self.socket.send(Message::text(message.to_string())).expect("the browser is there");
        loop {
            let Message::Text(text) = self.socket.read().expect("the browser answers in time") else { continue };
            let answer: Value = serde_json::from_str(&text).expect("BiDi speaks JSON");
            if answer["type"] == "event" {
                self.events.push(answer);
            } else if answer["id"] == self.next {
                assert_eq!(answer["type"], "success", "{method}: {answer}");
                return answer["result"].clone();
            }
        }
    }
}

impl Page for Firefox {
    fn open(&mut self, page: &Path) {
        self.events.clear();
        let url = format!("file://{}", page.display());
        self.call("browsingContext.navigate", json!({"context": self.context, "url": url, "wait": "complete"}));
    }

    fn complaints(&mut self) -> Vec<String> {
        self.eval("1");
        let seen = self
            .events
            .iter()
            .filter(|event| event["params"]["context"] != Value::Null || event["method"] == "log.entryAdded");
        seen.filter_map(|event| {
            let url = event["params"]["request"]["url"].as_str();
            let own = url.is_some_and(|url| ["data:", "blob:", "file:"].iter().any(|scheme| url.starts_with(scheme)));
            (!own).then(|| event.to_string())
        })
        .collect()
    }

    fn eval(&mut self, expression: &str) -> Value {
        // As text, so that what comes back is plain JSON.
        let params = json!({"expression": format!("JSON.stringify({expression})"), "target": {"context": self.context},
            "awaitPromise": false});
        let answer = self.call("script.evaluate", params);
        assert_eq!(answer["type"], "success", "{expression}: {answer}");
        answer["result"]["value"].as_str().map_or(Value::Null, |text| serde_json::from_str(text).expect("JSON"))
    }

    fn key(&mut self, key: &str, shift: bool) {
        let value = match key {
            "ArrowLeft" => "\u{E012}",
            "ArrowUp" => "\u{E013}",
            "ArrowRight" => "\u{E014}",
            "ArrowDown" => "\u{E015}",
            "Home" => "\u{E011}",
            "Tab" => "\u{E004}",
            letter => letter,
        };
        let mut actions = vec![json!({"type": "keyDown", "value": value}), json!({"type": "keyUp", "value": value})];
        if shift {
            actions.insert(0, json!({"type": "keyDown", "value": "\u{E008}"}));
            actions.push(json!({"type": "keyUp", "value": "\u{E008}"}));
        }
        let keyboard = json!({"type": "key", "id": "keyboard", "actions": actions});
        self.call("input.performActions", json!({"context": self.context, "actions": [keyboard]}));
    }

    fn download(&mut self, name: &str) -> PathBuf {
        awaited(&self.profile.path().join("downloads").join(name))
    }
}

impl Drop for Firefox {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn find() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("AUTOREF_FIREFOX") {
        return Some(named.into());
    }
    let folders = std::env::var_os("PATH")?;
    let names = ["firefox", "firefox-esr"];
    std::env::split_paths(&folders).flat_map(|folder| names.map(|name| folder.join(name))).find(|path| path.is_file())
}

/// The port that the browser writes down once it listens.
fn debugging_port(file: &Path) -> u16 {
    let started = Instant::now();
    loop {
        let text = std::fs::read_to_string(file).unwrap_or_default();
        let said: Option<Value> = serde_json::from_str(&text).ok();
        if let Some(port) = said.and_then(|said| said["ws_port"].as_u64()) {
            return u16::try_from(port).expect("a port");
        }
        assert!(started.elapsed() < PATIENCE, "the browser does not listen");
        std::thread::sleep(Duration::from_millis(20));
    }
}
