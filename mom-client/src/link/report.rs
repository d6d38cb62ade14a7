//! Reports of errors to a hub, by plain HTTP: they get through where nothing else does (M56).

use mom_net::{Address, NetError};
use serde_json::json;

use crate::ClientError;

/// Where a hub may listen for HTTP beside the port of its address.
const HTTP: u16 = 80;

/// The bytes of a report that a hub takes, with some for its keys.
const MOST: usize = 3072;

/// What a program reports of an error of its own.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// What happened, for people. It goes over the network in the clear.
    pub text: String,
    /// A word for it, such as that of a [`Code`](mom_proto::Code).
    pub code: Option<String>,
    /// Who reports.
    pub program: Option<String>,
    /// Its version.
    pub version: Option<String>,
}

impl Report {
    /// Of an error of a client.
    pub fn of(error: &ClientError) -> Report {
        Report {
            text: error.to_string(),
            code: error.wire().map(|error| error.code.word().to_owned()),
            ..Report::default()
        }
    }

    /// Names the program.
    #[must_use]
    pub fn by(self, program: &str, version: &str) -> Report {
        Report {
            program: Some(program.to_owned()),
            version: Some(version.to_owned()),
            ..self
        }
    }

    fn document(&self) -> String {
        let mut end = self.text.len().min(MOST);
        while !self.text.is_char_boundary(end) {
            end -= 1;
        }
        let mut document = json!({ "text": self.text[..end], "level": "error" });
        for (key, word) in [
            ("code", &self.code),
            ("program", &self.program),
            ("version", &self.version),
        ] {
            if let Some(word) = word {
                document[key] = word.as_str().into();
            }
        }
        document.to_string()
    }
}

/// Reports an error to the hub at an address, without a login and without TLS, whatever the address says of it: at its port, or at
/// that of HTTP if nobody answers there.
///
/// # Errors
/// `Address` for a wrong address, `Connection` where no hub takes it.
pub async fn report(hub: &str, report: &Report) -> Result<(), ClientError> {
    send(&hub.parse()?, report).await
}

/// The same, at an address that was read.
pub(crate) async fn send(address: &Address, report: &Report) -> Result<(), ClientError> {
    let document = report.document();
    let post = |port| mom_net::post(&address.host, port, "/log", document.clone());
    let answer = match post(address.port).await {
        Err(NetError::Io(_)) if address.port != HTTP => post(HTTP).await,
        answer => answer,
    };
    let (status, said) = answer?;
    match status.is_success() {
        true => Ok(()),
        false => {
            let said = String::from_utf8_lossy(&said);
            Err(ClientError::Connection(format!(
                "the hub did not accept the report: {status} {}",
                said.trim()
            )))
        }
    }
}
