//! Words of columns that say which points are kept out of the fit.

use super::GcpRole;
use super::titles::folded;

/// What a cell says of a point's role.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Said {
    Role(GcpRole),
    /// A word that is none of a role's.
    Unknown,
}

const CHECK: Said = Said::Role(GcpRole::Check);
const CONTROL: Said = Said::Role(GcpRole::Control);

/// As [`bare`] leaves them.
const CHECKS: &[&str] = &[
    "check",
    "checkpoint",
    "checkpoints",
    "checkpt",
    "3dcheckpoint",
    "3dcheck",
    "check3d",
    "checkpoint3d",
    "chk",
    "chkpt",
    "cp",
    "icp",
    "vcp",
    "qc",
    "qcpoint",
    "validation",
    "validationpoint",
    "verification",
    "verificationpoint",
    "independentcheckpoint",
    "kontrollpunkt",
    "kontroll",
    "kontrolle",
    "prufpunkt",
    "pruefpunkt",
    "pointdeverification",
    "puntodeverificacion",
    "puntodecomprobacion",
    "pontodeverificacao",
    "puntodiverifica",
    "controlepunt",
];
const CONTROLS: &[&str] = &[
    "gcp",
    "gcps",
    "3dgcp",
    "gcp3d",
    "3d",
    "control",
    "controlpoint",
    "groundcontrol",
    "groundcontrolpoint",
    "3dcontrolpoint",
    "control3d",
    "horizontalcontrolpoint",
    "verticalcontrolpoint",
    "passpunkt",
    "passpunkte",
    "fixpunkt",
    "festpunkt",
    "appui",
    "pointdappui",
    "puntodecontrol",
    "puntodeapoyo",
    "pontodecontrole",
    "pontodeapoio",
    "puntodappoggio",
    "fastmerke",
    "point",
];
const YES: &[&str] = &[
    "1",
    "true",
    "yes",
    "y",
    "x",
    "on",
    "ja",
    "j",
    "wahr",
    "oui",
    "o",
    "vrai",
    "si",
    "verdadero",
    "sim",
    "verdadeiro",
    "vero",
    "waar",
    "sann",
    "sant",
    "sand",
    "tak",
    "prawda",
    "kylla",
    "tosi",
    "да",
    "истина",
    "✓",
    "✔",
    "☑",
    "✅",
];
const NO: &[&str] = &[
    "0", "false", "no", "n", "off", "nein", "falsch", "non", "faux", "falso", "nao", "nee", "onwaar", "nej", "nei",
    "falskt", "falsk", "usann", "usant", "nie", "falsz", "ei", "epatosi", "нет", "ложь", "✗", "✘", "☐", "❌",
];
/// Of points that take no part.
const OFF: &[&str] = &["unused", "notused", "ignore", "ignored", "disabled", "disable", "inactive", "skip", "excluded"];
const ON: &[&str] = &["used", "use", "enabled", "enable", "active"];

/// Small letters without accents, blanks and signs between words.
fn bare(text: &str) -> String {
    folded(text.trim())
        .replace(['_', ' ', '(', ')', '\'', '’', '"', '.', '\u{a0}'], "")
        .trim_end_matches('-')
        .to_owned()
}

fn bare_of(text: &str) -> String {
    let word = bare(text);
    if word.is_empty() { text.trim().to_owned() } else { word.replace('-', "") }
}

/// Words for a point that is kept out of the fit, as in Pix4D's and Metashape's lists.
pub(super) fn is_check(text: &str) -> bool {
    // Without its accent it is control in Portuguese.
    let is_french = || ["contrôle", "point de contrôle"].contains(&text.trim().to_lowercase().as_str());
    is_french() || CHECKS.contains(&bare_of(text).as_str())
}

fn is_among(text: &str, words: &[&[&str]]) -> bool {
    let (word, sign) = (bare_of(text), text.trim());
    words.iter().any(|words| words.contains(&word.as_str()) || words.contains(&sign))
}

/// Whether a dash says that nothing was entered.
fn is_nothing(text: &str) -> bool {
    ["-", "–", "—"].contains(&text.trim())
}

/// Under `role`, `type` or `use`.
pub(super) fn of_role(text: &str) -> Said {
    match () {
        () if is_nothing(text) => CONTROL,
        () if is_check(text) || is_among(text, &[OFF, &NO[1..]]) => CHECK,
        () if is_among(text, &[CONTROLS, YES, ON, &NO[..1]]) => CONTROL,
        () => Said::Unknown,
    }
}

/// Under `check`.
pub(super) fn of_check(text: &str) -> Said {
    match () {
        () if is_nothing(text) => CONTROL,
        () if is_check(text) || is_among(text, &[YES]) => CHECK,
        () if is_among(text, &[NO, CONTROLS]) => CONTROL,
        () => Said::Unknown,
    }
}

/// Under `enabled`: a marker that is switched off in Metashape is a check point.
pub(super) fn of_enabled(text: &str) -> Said {
    match () {
        () if is_nothing(text) => CONTROL,
        () if is_among(text, &[NO, OFF]) => CHECK,
        () if is_among(text, &[YES, ON]) => CONTROL,
        () => Said::Unknown,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_many_languages() {
        for text in [
            "check",
            "CHK",
            "check pt",
            "Check (3D)",
            "3D check point",
            "Prüfpunkt",
            "Kontrolle",
            "validation",
            "ICP",
            "VCP",
            "QC",
            "contrôle",
            "unused",
            "ignore",
            "disabled",
            "no",
            "CP",
        ] {
            assert_eq!(of_role(text), CHECK, "{text}");
        }
        for text in ["GCP", "3D GCP", "control", "Passpunkt", "point d'appui", "yes", "used", "0"] {
            assert_eq!(of_role(text), CONTROL, "{text}");
        }
        for text in ["controle", "BM", "tree"] {
            assert_eq!(of_role(text), Said::Unknown, "{text}");
        }
        for text in ["WAHR", "oui", "sí", "да", "✓", "yes", "1", "x", "check"] {
            assert_eq!(of_check(text), CHECK, "{text}");
        }
        for text in ["FALSCH", "nein", "0", "нет", "-"] {
            assert_eq!(of_check(text), CONTROL, "{text}");
        }
        for text in ["nein", "off", "n", "disabled", "0", "False", "não", "fałsz"] {
            assert_eq!(of_enabled(text), CHECK, "{text}");
        }
        assert_eq!((of_enabled("ja"), of_enabled("perhaps")), (CONTROL, Said::Unknown));
    }
}
