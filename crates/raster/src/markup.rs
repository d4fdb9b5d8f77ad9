//! Text in HTML and XML.

/// Text as it stands between tags and in attributes.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The head of a page that needs no network: its title as plain text, its style sheet. What follows is its body.
pub fn page_head(title: &str, style: &str) -> String {
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>{}</title><style>{style}</style>",
        escaped(title)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_makes_no_tag_and_ends_no_attribute() {
        assert_eq!(escaped(r#"<b a="x">&amp;"#), "&lt;b a=&quot;x&quot;&gt;&amp;amp;");
    }
}
