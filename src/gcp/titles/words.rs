//! The words themselves, as [`super::tidy`] leaves titles: small letters without accents. The first of a list that a
//! table has is taken, so that what says more stands before what says less.

pub(in crate::gcp) const NAMES: &[&str] = &[
    // English.
    "name", "id", "point", "pt", "gcp", "label", "point name", "pointname", "point id", "pointid", "pt id", "ptid",
    "pt name", "ptname", "gcp id", "gcp name", "gcp label", "point number", "point no", "point nr", "pointno",
    "pointnr",
    "pt no", "ptno", "pt nr", "ptnr", "pt#", "point#", "pnt", "pnt no", "pno", "point code", "marker", "target",
    "identifier", "station", "control point", "monument", "fid",
    // Norwegian, Swedish, Danish, Icelandic.
    "navn", "punkt", "punktnavn", "punktnr", "punkt nr", "punkt no", "punktnummer", "punkt navn", "punktid",
    "punkt id",
    "namn", "punktnamn", "punkt namn", "pktnr", "pnr", "pkt", "merke", "nafn", "punktur",
    // German.
    "pkt nr", "pkt no", "punkt nummer", "punktkennung", "punktkennzeichen", "pkz", "punktbezeichnung",
    "punkt bezeichnung", "punktname", "punkt name", "passpunkt", "passpunktnr", "passpunkt nr", "passpunktnummer",
    "pp nr", "bezeichnung", "bez", "kennung", "marke", "festpunkt",
    // Dutch.
    "naam", "punt", "puntnr", "punt nr", "puntnummer", "punt nummer", "puntnaam", "punt naam", "punt id", "puntid",
    // French.
    "nom", "nom du repere", "repere", "nom du point", "nom point", "no point", "no du point", "num point",
    "numero de point", "numero du point", "numero point", "id point", "mat", "matricule", "designation", "cible",
    "borne",
    // Italian, Spanish, Portuguese, Romanian, Catalan.
    "nome", "punto", "nome punto", "no punto", "n punto", "num punto", "numero punto", "id punto", "caposaldo",
    "nombre", "nombre del punto", "nombre punto", "numero de punto", "numero del punto", "designacion",
    "identificacion", "vertice", "estacion", "mojon", "hito", "ponto", "nome do ponto", "nome ponto", "no ponto",
    "n ponto", "numero do ponto", "num ponto", "id ponto", "identificacao", "designacao", "marco", "estacao", "punct",
    "nr punct", "nume", "nume punct", "punt de control",
    // Polish, Czech, Slovak, Slovenian, Croatian, Bosnian, Serbian.
    "nazwa", "nr punktu", "numer punktu", "nazwa punktu", "nr pkt", "oznaczenie", "bod", "cislo bodu", "c bodu",
    "nazev bodu", "oznaceni", "oznaceni bodu", "nazev", "nazov", "nazov bodu", "tocka", "stevilka tocke",
    "st tocke", "ime tocke", "broj tocke", "br tocke", "tacka", "broj tacke", "oznaka", "naziv", "ime",
    // Hungarian, Finnish, Estonian, Latvian, Lithuanian.
    "pont", "pontszam", "pontnev", "pont neve", "pont szama", "nev", "nimi", "piste", "pistenumero", "pisteen numero",
    "piste nro", "pisteen nimi", "pistetunnus", "tunnus", "pnro", "punkti nr", "punkti nimi", "punkts",
    "punkta nr", "nosaukums", "punktas", "punkto nr", "pavadinimas",
    // Turkish, Greek.
    "nokta", "nokta no", "nokta adi", "nokta ismi", "nokta numarasi", "n no", "n n", "ονομα", "σημειο", "ονομα σημειου",
    "αρ σημειου", "αριθμοσ σημειου", "κωδικοσ σημειου",
    // Russian, Ukrainian, Bulgarian, Serbian.
    "название", "имя", "имя точки", "точка", "номер точки", "no точки", "название точки", "имя пункта", "пункт",
    "номер пункта", "название пункта", "наименование", "марка", "назва", "назва точки", "име",
    "тачка", "точка no",
    // Japanese, Chinese, Korean.
    "點名", "點番號", "點番", "測點", "测點", "測點名", "測點番號", "點號", "點位", "點位名称", "控制點", "編號", "编號",
    "名称", "名稱", "점번호", "점명", "점이름", "측점", "측점명", "측점번호", "기준점", "이름",
    // MicMac's description of its columns, `#F=N X Y Z`.
    "f=n",
    // What may be a running number beside a name.
    "nr", "no", "number", "num", "nummer", "numer", "numero", "cislo", "номер", "番號", "번호", "sira no",
];
/// Titles that say which is which.
pub(in crate::gcp) const EASTINGS: &[&str] = &[
    "easting", "eastings", "east", "e", "ost", "oest", "øst", "ø", "aust", "utm e", "x easting", "grid easting",
    "grid east",
    "grid e", "local easting", "rechtswert", "rechts", "rw", "ostwert", "est", "este", "leste", "hoyre",
    "austur", "wschod", "oster", "ita", "oost", "dogu", "saga", "saga deger", "kelet", "keleti", "vychod", "vychodni",
    "vzhod", "istok", "ida", "austrumi", "rytai", "est utm", "abscisse est", "восток", "восточное", "схід", "изток",
    "исток", "ανατολη", "ανατολικα", "東", "東距", "東座標", "東坐標", "東向", "東方向", "横坐標", "横座標", "橫坐標",
    "橫座標", "동", "동쪽", "동거", "동좌표",
];
pub(in crate::gcp) const NORTHINGS: &[&str] = &[
    "northing", "northings", "north", "n", "nord", "utm n", "y northing", "grid northing", "grid north", "grid n",
    "local northing", "hochwert", "hoch", "hw", "nordwert", "nor", "norte", "nordur", "polnoc", "norr", "pohjoinen",
    "noord", "kuzey", "yukari", "yukari deger", "eszak", "eszaki", "sever", "severni", "sjever", "pohi", "ziemeli",
    "siaure", "север", "северное", "північ", "βορρασ", "βορεια", "北", "北距", "北座標", "北坐標", "北向", "北方向",
    "纵坐標", "縦座標", "縱坐標", "縱座標", "북", "북쪽", "북거", "북좌표",
];
/// Titles that do not: x is north in some countries.
pub(in crate::gcp) const XS: &[&str] = &["x", "geo x", "coord x", "mapx", "xcoord", "pos x", "point x", "х"];
pub(in crate::gcp) const YS: &[&str] = &["y", "geo y", "coord y", "mapy", "ycoord", "pos y", "point y", "у"];
/// Letters that say which is which only beside each other: Portuguese M and P (from the meridian, along it), Finnish I
/// and P (itä, pohjoinen).
pub(in crate::gcp) const LETTER_PAIRS: [[&str; 2]; 2] = [["m", "p"], ["i", "p"]];
pub(in crate::gcp) const HEIGHTS: &[&str] = &[
    "height", "h", "z", "elevation", "elev", "alt", "altitude", "ele", "el", "geo z", "point z", "ortho height",
    "orthometric height", "orthometric elevation", "ellipsoidal height", "ell height", "ellipsoid height", "ell h",
    "level", "rl", "høyde", "hoyde", "høgde", "højde", "hogde", "haed", "hojd", "hoejde", "hojde", "kote", "hohe",
    "hoehe",
    "ellipsoidische hohe", "gelandehohe", "nhn", "hoogte", "nap", "taw", "hauteur", "cote",
    "altitude orthometrique", "altitude ellipsoidale", "quota", "altezza", "quota ortometrica", "quota ellissoidica",
    "cota", "altura", "elevacion", "elevacao", "altitud", "altitude ortometrica", "altitud ortometrica",
    "altura ortometrica", "altura elipsoidal", "altitude elipsoidal", "altitude geometrica", "altitud elipsoidal",
    "inaltime", "altitudine", "alti", "niveau", "nivel", "meereshohe", "ellipsoidhohe", "н", "wysokosc", "rzedna",
    "vyska", "nadmorska vyska", "visina", "kota", "кота", "korkeus",
    "korgus", "augstums", "aukstis", "magassag", "yukseklik", "kot", "высота", "отметка", "висота", "височина",
    "υψομετρο", "υψοσ", "標高", "高さ", "楕円体高", "高程", "高", "海拔", "표고", "높이", "고도", "正高",
];
/// What heights count from, each a title of its own, and beside one of the words above.
pub(in crate::gcp) const LEVELS: &[&str] = &[
    "nn", "hnn", "nhn", "hnhn", "nhn2016", "dhhn92", "dhhn2016", "ln02", "lhn95", "mum", "nn2000", "nn1954", "moh",
    "hoh",
    "mnn", "rh2000", "rh70", "rh00", "dvr90", "n2000", "n60", "nap", "taw", "ngf", "ign69", "ngf ign69", "bpv",
    "kronsztad", "kron86",
    "pl kron86 nh", "pl evrf2007 nh", "evrf2007", "evrs", "eh2000", "bk77", "las07", "las 2000 5", "mbalti", "balti",
    "slm", "snm",
    "nmm", "msl", "amsl", "asl", "navd88", "ngvd29", "cgvd28", "cgvd2013", "ahd", "odn", "nzvd2016", "бс77", "бс",
    "해발고", "해발", "egm96", "egm2008",
];
/// The same for heights above the ellipsoid, which are taken where no other is.
pub(in crate::gcp) const ELLIPSOIDAL: &[&str] = &[
    "ell", "hell", "ellip", "ellips", "ellipsoid", "ellipsoidal", "ellipsoidale", "ellipsoidische", "ellipsoidhohe",
    "ellipsoidisch",
    "ellipsoidisk", "ellipsoidico", "ellissoidica", "ellissoidico", "elipsoidal", "elipsoidalna", "elipsoidica",
    "elipsoidowa", "elipsoidicka", "geodetic", "geodatische", "geodetica", "geometrica", "эллипсоидальная",
    "эллипсоидная",
    "геодезическая", "ellipsoidikorkeus", "楕円体高", "椭球高", "橢球高", "大地高", "타원체고",
];
/// Words beside those of heights that change nothing.
pub(super) const HEIGHT_QUALIFIERS: &[&str] = &[
    "m", "u", "uber", "ub", "u m", "a", "over", "havet", "hav", "havsytan", "above", "sea", "mean", "the", "of",
    "de", "del", "mar", "sobre", "sur",
    "tov", "t", "o", "v", "n p m", "npm", "nad", "morem", "nadmorska", "nadmorsky", "terenu", "terrain", "terreno",
    "gelande",
    "ground", "grid", "local", "orth", "ortho", "orthometric", "orthometrisch", "orthometrische", "orthometrique", "ortometrik",
    "ortometrica",
    "ortometrico", "ortometrisk", "ortometryczna", "ortometrijska", "ortometricka", "normal", "normalhohe",
    "physical", "абс",
    "абсолютная", "абсолютна", "нормальная", "ортометрическая", "точки", "м", "геоидная", "geoidica", "geoidale",
    "ht", "hgt", "wert", "value", "c", "s", "l", "f", "p",
];
/// Heights where no other title says them: Hungarian magasság beside X and Y, Finnish korkeus beside P and I, Italian
/// quota beside E and N.
pub(in crate::gcp) const SHORT_HEIGHTS: &[&str] = &["m", "k", "q"];
pub(in crate::gcp) const LONGITUDES: &[&str] = &[
    "lon", "long", "longitude", "lng", "lengdegrad", "longitude deg", "lon deg", "lange", "laenge",
    "geographische lange",
    "longitud", "longitudine", "lengtegraad", "dlugosc", "dlugosc geograficzna", "zemepisna delka", "delka",
    "pituusaste", "boylam", "hosszusag", "foldrajzi hosszusag", "経度", "經度", "经度", "경도", "долгота",
    "γεωγραφικο μηκοσ", "west longitude", "east longitude", "longitude west", "longitude east", "lon west", "lon east",
    "longitude w", "longitude e", "lon w", "lon e",
];
pub(in crate::gcp) const LATITUDES: &[&str] = &[
    "lat", "latitude", "breddegrad", "latitude deg", "lat deg", "breite", "geographische breite", "latitud",
    "latitudine", "breedtegraad", "szerokosc", "szerokosc geograficzna", "zemepisna sirka", "sirka", "leveysaste",
    "enlem", "szelesseg", "foldrajzi szelesseg", "緯度", "纬度", "위도", "широта", "γεωγραφικο πλατοσ",
    "north latitude", "south latitude", "latitude north", "latitude south", "lat north", "lat south", "latitude n",
    "latitude s", "lat n", "lat s",
];
pub(in crate::gcp) const SIGMAS: &[&str] = &[
    "sigma m", "sigma", "accuracy", "accuracy m", "std", "accuracy horz", "xy accuracy", "horizontal accuracy",
    "hrms",
    "genauigkeit", "lagegenauigkeit", "nøyaktighet", "noyaktighet", "nauwkeurigheid", "precisione", "precisao",
    "hz prec", "hz precision", "horizontal precision", "horizontal prec", "h prec", "ce95", "ce90", "ce99",
    "incertitude plani", "accuracy x/y", "accuracy x/y/z", "accuracy xy",
];
/// Accuracies of each coordinate.
pub(in crate::gcp) const SIGMA_EASTS: &[&str] =
    &["accuracy x", "x accuracy", "sigma x", "sigma e", "std x", "easting rms", "std dev e", "std dev easting", "std dev x",
    "std e", "sd e", "sx", "se", "ix", "me", "sde", "sdx"];
pub(in crate::gcp) const SIGMA_NORTHS: &[&str] =
    &["accuracy y", "y accuracy", "sigma y", "sigma n", "std y", "std dev n", "std dev northing", "std dev y", "std n",
    "sd n", "sy", "sn", "iy", "northing rms", "mn", "sdn", "sdy"];
pub(in crate::gcp) const SIGMA_HEIGHTS: &[&str] = &[
    "sigma height m", "sigma h", "accuracy z", "accuracy vert", "z accuracy", "vertical accuracy", "vrms",
    "hohengenauigkeit", "sigma z",
    "std z", "std dev h", "std dev z", "std dev height", "std dev elevation", "std h", "sd h", "sd z", "vt prec",
    "vt precision", "vertical precision", "vertical prec", "v prec", "le95", "le90", "le99", "elevation rms", "incertitude alti", "accuracy x/y/z", "accuracy z/altitude",
];
/// Titles so short that they mean an accuracy of the height beside those of both coordinates only.
pub(in crate::gcp) const SHORT_SIGMA_HEIGHTS: &[&str] = &["sz", "sh", "iz", "mh", "sdu", "sdz", "sdh"];
pub(in crate::gcp) const ROLES: &[&str] = &["role", "type", "use", "point type"];
pub(in crate::gcp) const CHECKS: &[&str] = &["check", "checkpoint", "check point", "is check", "kontrollpunkt"];
pub(in crate::gcp) const ENABLED: &[&str] = &["enabled", "enable"];
/// Words beside the letter or direction that is meant ("Coordenada X", "Ost-Koordinate").
pub(super) const COORDINATE_WORDS: &[&str] = &[
    "coord", "coords", "coordinate", "coordinates", "coordenada", "coordenadas", "coordonnee", "coordonnees",
    "coordinata", "coordinaat", "coordonata", "koordinate", "koordinaten", "koord", "koordinat", "koordinata",
    "koordinaatti", "koordinaat", "souradnice", "suradnica", "wspolrzedna", "wsp", "координата", "συντεταγμενη",
];
/// The same where no blank stands between the words.
pub(super) const COORDINATE_ENDINGS: &[&str] = &["koordinate", "koordinat", "座標", "坐標", "좌표"];
/// Words of columns that tell rows apart and name no point.
pub(super) const NO_NAMES: &[&str] = &[
    "date", "time", "datetime", "timestamp", "datum", "zeit", "uhrzeit", "dato", "tid", "fecha", "hora", "data",
    "heure",
    "utc", "epoch", "epoque", "image", "photo", "foto", "file", "camera", "pixel", "px", "lat", "lon", "latitude",
    "longitude", "rms", "accuracy", "sigma", "std", "error", "residual", "url", "link", "comment", "sx", "sy", "sz",
    "distance", "azimuth", "antenna", "geoid", "ellipsoidal", "sourcex", "sourcey",
    // Of how well and with what it was measured.
    "pdop", "hdop", "vdop", "gdop", "tdop", "dop", "satellites", "satellite", "sats", "sat", "nsat", "nsats", "sv",
    "svs", "satelliten",
    "satellitter", "satelliter", "satellieten", "satelites", "satelliti", "satelity", "satelitow", "спутники",
    "спутников",
    "衛星數", "卫星數", "quality", "qualitat", "qualite", "calidad", "qualidade", "qualita", "kvalitet", "kwaliteit",
    "jakosc",
    "kvalita", "качество", "status", "state", "statut", "estado", "stato", "stan", "статус", "fix", "solution", "q",
    "ns", "age", "ratio", "correction", "corrections", "mount",
    "mountpoint", "rod", "pole", "antennenhohe", "ant", "epochs", "epochen", "samples", "averaging", "mode", "week",
    "base",
    "baseline", "method", "methode", "lateral", "undulation", "separation", "anzahl", "count", "fixed", "tilt",
    "cov", "covariance", "sdx", "sdy", "sdz",
    "sde", "sdn", "sdu", "precision", "prec", "hrms", "vrms", "snr", "sec", "tow",
];
