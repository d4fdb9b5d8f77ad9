//! Text in HTML and XML.

/// Text as it stands between tags and in attributes.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_makes_no_tag_and_ends_no_attribute() {
        assert_eq!(escaped(r#"<b a="x">&amp;"#), "&lt;b a=&quot;x&quot;&gt;&amp;amp;");
    }
}
