//! Letters without accents, as tables write them or leave them out: "Číslo bodu" and "CISLO BODU" are one title.

/// Small letters without accents; letters of double width are narrow ones, signs for "number" are "no".
pub(in crate::gcp) fn folded(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    for letter in text.chars().flat_map(char::to_lowercase) {
        match letter {
            // Marks that stand behind the letter they belong to, as the files of a Mac have them.
            '\u{300}'..='\u{36f}' => {}
            '\u{ff01}'..='\u{ff5e}' => plain.extend(narrow(letter).to_lowercase()),
            'æ' => plain.push_str("ae"),
            'œ' => plain.push_str("oe"),
            'ß' => plain.push_str("ss"),
            'þ' => plain.push_str("th"),
            '№' => plain.push_str("no"),
            other => plain.push(bare(other)),
        }
    }
    plain
}

/// The letter of single width.
fn narrow(letter: char) -> char {
    const OFFSET: u32 = 0xFEE0;
    char::from_u32(letter as u32 - OFFSET).unwrap_or(letter)
}

/// The letter without its accent. The ø stays, which alone is east where an o would be west.
fn bare(letter: char) -> char {
    const ACCENTED: [(char, &str); 34] = [
        ('a', "àáâãäåāăąª"),
        ('c', "çćĉċč"),
        ('d', "ďđð"),
        ('e', "èéêëēĕėęě"),
        ('g', "ĝğġģ"),
        ('h', "ĥħ"),
        ('i', "ìíîïĩīĭįı"),
        ('j', "ĵ"),
        ('k', "ķ"),
        ('l', "ĺļľŀł"),
        ('n', "ñńņňŉ"),
        ('o', "òóôõöōŏőº°"),
        ('r', "ŕŗř"),
        ('s', "śŝşšș"),
        ('t', "ţťŧț"),
        ('u', "ùúûüũūŭůűų"),
        ('w', "ŵ"),
        ('y', "ýÿŷ"),
        ('z', "źżž"),
        ('α', "ά"),
        ('ε', "έ"),
        ('η', "ή"),
        ('ι', "ίϊΐ"),
        ('ο', "ό"),
        ('υ', "ύϋΰ"),
        ('ω', "ώ"),
        ('σ', "ς"),
        ('е', "ё"),
        ('и', "й"),
        ('і', "ї"),
        ('東', "东"),
        ('點', "点"),
        ('號', "号"),
        ('標', "标"),
    ];
    ACCENTED.iter().find(|(_, letters)| letters.contains(letter)).map_or(letter, |(plain, _)| *plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accents_and_widths_do_not_matter() {
        for (text, plain) in [
            ("Číslo BODU", "cislo bodu"),
            ("N° point", "no point"),
            ("№", "no"),
            ("Ｘ座標（ｍ）", "x座標(m)"),
            ("İstasyon Adı", "istasyon adi"),
            ("e\u{301}le\u{301}vation", "elevation"),
            ("ΎΨΟΣ", "υψοσ"),
            ("东坐标", "東坐標"),
            ("Hæð", "haed"),
            ("Größe", "grosse"),
        ] {
            assert_eq!(folded(text), plain, "{text}");
        }
    }
}
