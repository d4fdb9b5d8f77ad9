//! What a coded target says of itself.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Family (dictionary) and number of a coded target; as text `family:number`, for example `apriltag-36h11:17`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Code {
    pub family: String,
    pub number: u32,
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.family, self.number)
    }
}

impl From<Code> for String {
    fn from(code: Code) -> String {
        code.to_string()
    }
}

impl FromStr for Code {
    type Err = String;

    /// # Errors
    /// When the text is not `family:number`; the message says so.
    fn from_str(text: &str) -> Result<Code, String> {
        let wrong = || format!("`{text}` is no code; one is written family:number, as in apriltag-36h11:17");
        let (family, number) = text.rsplit_once(':').ok_or_else(wrong)?;
        let plain = !family.is_empty() && family.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_');
        let number = number.parse().map_err(|_| wrong())?;
        if plain { Ok(Code { family: family.to_string(), number }) } else { Err(wrong()) }
    }
}

impl TryFrom<String> for Code {
    type Error = String;

    fn try_from(text: String) -> Result<Code, String> {
        text.parse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_survive_their_text_and_other_text_is_refused() {
        let code = Code { family: "aruco-4x4-50".into(), number: 7 };
        assert_eq!(code.to_string().parse(), Ok(code.clone()));
        let json = serde_json::to_string(&code).expect("a string");
        assert_eq!(json, "\"aruco-4x4-50:7\"");
        assert_eq!(serde_json::from_str::<Code>(&json).expect("a code"), code);
        for bad in ["", "17", ":17", "a:", "a:-1", "a,b:1", "a:99999999999"] {
            assert!(bad.parse::<Code>().is_err(), "{bad}");
        }
    }
}
