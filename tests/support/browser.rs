//! A browser without a window, told what to do over Chromium's debugging pipe (the DevTools
//! protocol: JSON messages, each ended by a zero byte).

use super::skip::skipped;
use serde_json::{Value, json};
use std::cell::{Cell, RefCell};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Names that a browser goes by.
const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
/// What a browser may take to answer before it counts as dead.
const PATIENCE: Duration = Duration::from_secs(120);

/// A browser with one page.
pub struct Browser {
    child: Child,
    input: RefCell<ChildStdin>,
    messages: Receiver<Value>,
    number: Cell<u64>,
    session: RefCell<Option<String>>,
    /// Everything that it said unasked.
    events: RefCell<Vec<Value>>,
}

/// The browser of this machine: the one that `AVENTAIL_BROWSER` names, which must be there, or one
/// on the path.
fn program() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("AVENTAIL_BROWSER").filter(|v| !v.is_empty()) {
        let named = PathBuf::from(named);
        assert!(named.is_file(), "AVENTAIL_BROWSER names no file: {}", named.display());
        return Some(named);
    }
    let path = std::env::var_os("PATH")?;
    let all = std::env::split_paths(&path).flat_map(|folder| NAMES.map(|name| folder.join(name)));
    all.into_iter().find(|file| file.is_file())
}

impl Browser {
    /// Starts a browser with a profile in `folder`; `None`, with a line that says so, where the
    /// machine has none.
    pub fn start(folder: &Path) -> Option<Self> {
        let Some(program) = program() else {
            skipped("no chromium here; install it, or name one in AVENTAIL_BROWSER");
            return None;
        };
        // The browser reads from descriptor 3 and writes to 4: a shell puts the pipes there.
        let mut child = Command::new("sh")
            .args(["-c", "exec \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1", "sh"])
            .arg(program)
            .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"])
            .args(["--no-first-run", "--remote-debugging-pipe"])
            .arg(format!("--user-data-dir={}", folder.join("profile").display()))
            .arg("about:blank")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("a shell starts");
        let (input, output) = (child.stdin.take().expect("piped"), child.stdout.take().expect("piped"));
        let (send, messages) = channel();
        std::thread::spawn(move || {
            for message in BufReader::new(output).split(0) {
                let Ok(message) = message else { return };
                let value = serde_json::from_slice(&message).expect("the browser writes JSON");
                if send.send(value).is_err() {
                    return;
                }
            }
        });
        let browser = Self {
            child,
            input: RefCell::new(input),
            messages,
            number: Cell::new(0),
            session: RefCell::new(None),
            events: RefCell::new(Vec::new()),
        };
        let targets = browser.call("Target.getTargets", json!({}));
        let targets = targets["targetInfos"].as_array().expect("a list");
        let page = targets.iter().find(|t| t["type"] == "page").expect("a page is open");
        let attached = browser.call("Target.attachToTarget", json!({ "targetId": page["targetId"], "flatten": true }));
        *browser.session.borrow_mut() = attached["sessionId"].as_str().map(String::from);
        for domain in ["Page", "Runtime", "Log", "Network"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        Some(browser)
    }

    /// Opens an address.
    pub fn open_address(&self, address: &str) {
        let answer = self.call("Page.navigate", json!({ "url": address }));
        assert!(answer["errorText"].is_null(), "{answer}");
        self.wait(&format!("location.href === {} && document.readyState === 'complete'", json!(address)));
    }

    /// Calls a method of the protocol; returns its result.
    pub fn call(&self, method: &str, parameters: Value) -> Value {
        self.number.set(self.number.get() + 1);
        let mut message = json!({ "id": self.number.get(), "method": method, "params": parameters });
        if let Some(session) = &*self.session.borrow() {
            message["sessionId"] = session.as_str().into();
        }
        let mut bytes = message.to_string().into_bytes();
        bytes.push(0);
        self.input.borrow_mut().write_all(&bytes).expect("the browser listens");
        loop {
            let message = self.messages.recv_timeout(PATIENCE).expect("the browser answers");
            if message["id"] == self.number.get() {
                assert!(message["error"].is_null(), "{method}: {}", message["error"]);
                return message["result"].clone();
            }
            self.events.borrow_mut().push(message);
        }
    }

    /// The value of an expression in the page; promises are waited for.
    pub fn value(&self, expression: &str) -> Value {
        let parameters = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let answer = self.call("Runtime.evaluate", parameters);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {}", answer["exceptionDetails"]);
        answer["result"]["value"].clone()
    }

    /// The text that an expression gives.
    pub fn text(&self, expression: &str) -> String {
        let value = self.value(expression);
        value.as_str().unwrap_or_else(|| panic!("{expression}: {value} is no text")).to_owned()
    }

    /// Waits until an expression is true.
    pub fn wait(&self, expression: &str) {
        let begin = Instant::now();
        while self.value(expression) != json!(true) {
            assert!(begin.elapsed() < PATIENCE, "never true: {expression}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Opens a file and waits until it is there.
    pub fn open(&self, file: &Path) {
        let file = std::fs::canonicalize(file).expect("the page is there");
        let address = format!("file://{}", file.display());
        self.open_address(&address);
    }

    /// Presses and releases a key.
    pub fn press(&self, key: &str) {
        for kind in ["keyDown", "keyUp"] {
            self.call("Input.dispatchKeyEvent", json!({ "type": kind, "key": key }));
        }
    }

    /// What it complained of, and the addresses that it asked for, so far.
    pub fn complaints_and_requests(&self) -> (Vec<String>, Vec<String>) {
        self.value("1"); // takes what has come meanwhile
        let (mut complaints, mut requests) = (Vec::new(), Vec::new());
        for event in self.events.borrow().iter() {
            match event["method"].as_str() {
                Some("Runtime.consoleAPICalled" | "Runtime.exceptionThrown" | "Log.entryAdded") => {
                    complaints.push(event["params"].to_string());
                }
                Some("Network.requestWillBeSent") => {
                    requests.extend(event["params"]["request"]["url"].as_str().map(String::from));
                }
                _ => {}
            }
        }
        (complaints, requests)
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Its helpers end with it.
        let _ = self.input.borrow_mut().write_all(b"{\"id\":0,\"method\":\"Browser.close\"}\0");
        let begin = Instant::now();
        while begin.elapsed() < Duration::from_secs(5) {
            if self.child.try_wait().is_ok_and(|status| status.is_some()) {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
