//! The titles of tables that surveyors write, and what they stand for.

pub(super) const NAMES: &[&str] = &[
    "name",
    "id",
    "point",
    "pt",
    "gcp",
    "label",
    "navn",
    "punkt",
    "punktnavn",
    "punktnr",
    "punkt nr",
    "nr",
    "no",
    "number",
    "pointid",
    "point id",
    "point name",
    "gcp id",
    "gcp name",
    "gcp label",
    "point number",
    "punktnummer",
    "nom",
    "nome",
    "nombre",
    "pktnr",
    "pnr",
    "pkt",
    "pt#",
    "point#",
    "nummer",
    "marke",
    "target",
    "ponto",
    "название",
    "fid",
    "station",
    "nafn",
    "nazwa",
    "namn",
    "nimi",
    "naam",
    "matricule",
    "punto",
    "punktnamn",
    "numer",
    "numero",
    "número",
    "numéro",
    "bezeichnung",
    "identifier",
    "repere",
    "nom du repere",
    // MicMac's description of its columns, `#F=N X Y Z`.
    "f=n",
    "designation",
    "désignation",
    "designación",
    "nokta",
    "nokta no",
    "nokta adı",
    "nokta adi",
    "pont",
    "pontszám",
    "pontnév",
    "pontnev",
    "点名",
    "点番号",
    "測点",
    "測点名",
    "点号",
    "имя",
    "имя точки",
    "точка",
    "номер",
    "номер точки",
    "название точки",
    "№",
    "όνομα",
    "ονομα",
    "σημείο",
    "σημειο",
];
/// Titles that say which is which.
pub(super) const EASTINGS: &[&str] = &[
    "easting",
    "east",
    "e",
    "øst",
    "ost",
    "aust",
    "utm e",
    "x easting",
    "e m",
    "easting m",
    "rechtswert",
    "rw",
    "ostwert",
    "est",
    "este",
    "ø",
    "hoyre",
    "local easting",
    "austur",
    "wschód",
    "wschod",
    "öst",
    "öster",
    "itä",
    "oost",
    "leste",
    "grid easting",
    "grid east",
    "grid e",
    "doğu",
    "dogu",
    "sağa",
    "saga",
    "sağa değer",
    "kelet",
    "keleti",
    "東",
    "東距",
    "東座標",
    "восток",
    "восточное",
    "ανατολή",
    "ανατολη",
    "ανατολικά",
    "ανατολικα",
];
pub(super) const NORTHINGS: &[&str] = &[
    "northing",
    "north",
    "n",
    "nord",
    "utm n",
    "y northing",
    "n m",
    "northing m",
    "hochwert",
    "hw",
    "nordwert",
    "nor",
    "norte",
    "local northing",
    "norður",
    "północ",
    "polnoc",
    "norr",
    "pohjoinen",
    "noord",
    "grid northing",
    "grid north",
    "grid n",
    "kuzey",
    "yukarı",
    "yukari",
    "yukarı değer",
    "észak",
    "eszak",
    "északi",
    "eszaki",
    "北",
    "北距",
    "北座標",
    "север",
    "северное",
    "βορράς",
    "βορρας",
    "βόρεια",
    "βορεια",
];
/// Titles that do not: x is north in some countries.
pub(super) const XS: &[&str] = &["x", "geo x", "coord x", "x m", "mapx", "x coordinate", "xcoord", "pos x", "point x"];
pub(super) const YS: &[&str] = &["y", "geo y", "coord y", "y m", "mapy", "y coordinate", "ycoord", "pos y", "point y"];
pub(super) const HEIGHTS: &[&str] = &[
    "height",
    "h",
    "z",
    "elevation",
    "elev",
    "alt",
    "altitude",
    "høyde",
    "hoyde",
    "height m",
    "kote",
    "z m",
    "geo z",
    "point z",
    "ele",
    "höhe",
    "hoehe",
    "quota",
    "cota",
    "ortho height",
    "ellipsoidal height",
    "altitude m",
    "elevation m",
    "høgde",
    "hæð",
    "wysokość",
    "wysokosc",
    "höjd",
    "korkeus",
    "hoogte",
    "altura",
    "elevación",
    "élévation",
    "hauteur",
    "altezza",
    "ell height",
    "ellipsoid height",
    "ell h",
    "ellipsoidische höhe",
    "orthometric height",
    "orthometric elevation",
    "altitude ortométrica",
    "altitude ortometrica",
    "altitud ortométrica",
    "altitud ortometrica",
    "altura ortométrica",
    "altura ortometrica",
    "altura elipsoidal",
    "altitude elipsoidal",
    "altitude geométrica",
    "altitude geometrica",
    "altitud elipsoidal",
    "altitude orthométrique",
    "altitude ellipsoïdale",
    "quota ortometrica",
    "quota ellissoidica",
    "yükseklik",
    "yukseklik",
    "kot",
    "magasság",
    "magassag",
    "標高",
    "楕円体高",
    "высота",
    "отметка",
    "υψόμετρο",
    "υψομετρο",
    "ύψος",
    "υψος",
];
pub(super) const LONGITUDES: &[&str] = &[
    "lon",
    "long",
    "longitude",
    "lng",
    "lengdegrad",
    "longitude deg",
    "lon deg",
    "länge",
    "laenge",
    "longitud",
    "boylam",
    "hosszúság",
    "földrajzi hosszúság",
    "経度",
    "долгота",
    "γεωγραφικό μήκος",
    "γεωγραφικο μηκος",
];
pub(super) const LATITUDES: &[&str] = &[
    "lat",
    "latitude",
    "breddegrad",
    "latitude deg",
    "lat deg",
    "breite",
    "latitud",
    "enlem",
    "szélesség",
    "földrajzi szélesség",
    "緯度",
    "широта",
    "γεωγραφικό πλάτος",
    "γεωγραφικο πλατος",
];
pub(super) const SIGMAS: &[&str] = &[
    "sigma m",
    "sigma",
    "accuracy",
    "accuracy m",
    "std",
    "accuracy horz",
    "xy accuracy",
    "horizontal accuracy",
    "hrms",
    "incertitude plani",
    "accuracy x/y",
    "accuracy x/y/z",
    "accuracy xy",
];
/// Accuracies of each coordinate.
pub(super) const SIGMA_EASTS: &[&str] =
    &["accuracy x", "x accuracy", "sigma x", "sigma e", "std x", "easting rms", "sx", "se", "ix"];
pub(super) const SIGMA_NORTHS: &[&str] =
    &["accuracy y", "y accuracy", "sigma y", "sigma n", "std y", "sy", "sn", "iy", "northing rms"];
pub(super) const SIGMA_HEIGHTS: &[&str] = &[
    "sigma height m",
    "sigma h",
    "accuracy z",
    "accuracy vert",
    "z accuracy",
    "vertical accuracy",
    "vrms",
    "sigma z",
    "std z",
    "elevation rms",
    "incertitude alti",
    "accuracy x/y/z",
    "accuracy z/altitude",
];
/// Titles so short that they mean an accuracy of the height beside those of both coordinates only.
pub(super) const SHORT_SIGMA_HEIGHTS: &[&str] = &["sz", "sh", "iz"];
pub(super) const ROLES: &[&str] = &["role", "type", "use", "point type"];
pub(super) const CHECKS: &[&str] = &["check", "checkpoint", "check point", "is check", "kontrollpunkt"];
pub(super) const ENABLED: &[&str] = &["enabled", "enable"];

/// "Easting [m]" and "EASTING_(m)" are "easting"; underscores and hyphens are blanks.
pub(super) fn tidy(title: &str) -> String {
    let lower = title.trim_matches(['"', '\'', ' ', '\u{feff}']).to_lowercase();
    let head = lower.split(['[', '(']).next().unwrap_or_default();
    head.replace(['_', '-', '.', ':'], " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// In order of the names: "northing" before "n". A title such as "X/East" counts as both of its halves, and "E_GNSS" as
/// what stands before the system.
pub(super) fn find(titles: &[String], names: &[&str]) -> Option<usize> {
    // The halves of "Accuracy X/Y" are no coordinates.
    let is_accuracy = |title: &str| ["accuracy", "sigma", "std", "error"].iter().any(|word| title.starts_with(word));
    let whole = |title: &String, name: &str| {
        title == name || (!is_accuracy(title) && title.split('/').any(|half| half.trim() == name))
    };
    let among = |is: &dyn Fn(&String, &str) -> bool| {
        names.iter().find_map(|name| titles.iter().position(|title| is(title, name)))
    };
    // A title that is the word alone wins over one with a system beside it.
    among(&whole)
        .or_else(|| among(&|title, name| without_system(title) == Some(name)))
        .or_else(|| among(&|title, name| is_accuracy(title) && without_unit(title) == Some(name)))
}

/// "sigma mm" without its unit.
fn without_unit(title: &str) -> Option<&str> {
    title.rsplit_once(' ').filter(|(_, unit)| matches!(*unit, "mm" | "cm" | "m")).map(|(head, _)| head)
}

/// A title of two words less the one that names what the coordinates were measured with or in.
fn without_system(title: &str) -> Option<&str> {
    let (head, tail) = title.split_once(' ')?;
    let is_datum = |word: &str| matches!(word, "wgs84" | "etrs89" | "euref89" | "nad83" | "nad27");
    let is_way = |word: &str| matches!(word, "gnss" | "gps" | "rtk") || (word.starts_with("utm") && word.len() > 3);
    if is_datum(head) { Some(tail) } else { (is_datum(tail) || is_way(tail)).then_some(head) }
}

/// A column whose title has a word that names points have ("local_id", "GCP_PointNr"): its values must show that it
/// does.
pub(super) fn find_likely_name(titles: &[String]) -> Option<usize> {
    titles.iter().position(|title| {
        let words: Vec<&str> = title.split(' ').collect();
        let is_of_an_image = ["image", "photo", "file", "camera"].iter().any(|word| words.contains(word));
        let ends = ["id", "nr", "name", "pointnr", "punktnr"].contains(words.last().expect("a split has a part"));
        !is_of_an_image && words.len() > 1 && (ends || words[0] == "id")
    })
}

/// Whether a title is one of those for the horizontal coordinates.
pub(super) fn is_coordinate(title: &str) -> bool {
    let tidied = [tidy(title)];
    [EASTINGS, NORTHINGS, XS, YS, LONGITUDES, LATITUDES].iter().any(|names| find(&tidied, names).is_some())
}

/// Whether a title is that of a role, by any of its words.
pub(super) fn is_role(title: &str) -> bool {
    [ROLES, CHECKS, ENABLED].iter().any(|names| names.contains(&title))
}

/// Whether a title is one of those that a table's reader knows.
pub(super) fn is_known(title: &str) -> bool {
    let tidied = [tidy(title)];
    is_coordinate(title)
        || [NAMES, HEIGHTS, SIGMAS, SIGMA_EASTS, SIGMA_NORTHS, SIGMA_HEIGHTS]
            .iter()
            .any(|names| find(&tidied, names).is_some())
}
