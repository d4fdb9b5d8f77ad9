#!/usr/bin/env python3
"""fuzz/seeds.py TARGET FOLDER: writes small valid files for a fuzz target; where there are several endings, the first byte chooses."""

import pathlib
import struct
import sys

LISTS = [".csv", ".txt", ".points", ".kof", ".xml", ".geojson", ".json"]
DOCUMENTS = [".toml", ".json", ".csv", ".xml"]
FLIGHTS = [".xml", ".json", ".csv", ".txt", ".toml"]
OUTLINES = [".toml", ".geojson", ".txt"]


def las():
    """LAS 1.2, point format 0, two points."""
    header = bytearray(227)
    header[0:4] = b"LASF"
    header[24:26] = bytes([1, 2])
    struct.pack_into("<HII", header, 94, 227, 227, 0)
    header[104] = 0
    struct.pack_into("<HI", header, 105, 20, 2)
    struct.pack_into("<5I", header, 111, 2, 0, 0, 0, 0)
    struct.pack_into("<12d", header, 131, 0.01, 0.01, 0.01, 0, 0, 0, 2, 1, 2, 1, 2, 1)
    points = b"".join(struct.pack("<3iHBBbBH", 100 * k, 100 * k, 100 * k, 5, 9, 2, 0, 0, 1) for k in (1, 2))
    return bytes(header) + points


def e57():
    """Two points in one packet, without the checksums of the pages, which the target adds."""
    axes = "".join(f'<cartesian{axis} type="Float" precision="single"/>' for axis in "XYZ")
    colour = '<colorRed type="Integer" minimum="0" maximum="255"/>'
    points = f'<points type="CompressedVector" fileOffset="48" recordCount="2"><prototype type="Structure">{axes}{colour}</prototype></points>'
    pose = '<pose type="Structure"><translation type="Structure"><x type="Float">1</x><y type="Float">2</y><z type="Float">3</z></translation></pose>'
    root = '<formatName type="String">ASTM E57 3D Imaging Data File</formatName><guid type="String">g</guid><versionMajor type="Integer">1</versionMajor>'
    xml = f'<e57Root type="Structure">{root}<data3D type="Vector"><vectorChild type="Structure">{pose}{points}</vectorChild></data3D></e57Root>'.encode()
    packet = struct.pack("<BBHH4H", 1, 0, 43, 4, 8, 8, 8, 2) + struct.pack("<6f2B", 1, 2, 3, 4, 5, 6, 7, 8) + bytes(4)
    section = struct.pack("<B7x3Q", 1, 32 + len(packet), 80, 0) + packet
    header = b"ASTM-E57" + struct.pack("<2I4Q", 1, 0, 1024, 48 + len(section), len(xml), 1024)
    content = header + section + xml
    assert len(packet) == 44 and len(content) <= 1020
    return content


def tiff(keys):
    """A picture of 2 x 2 grey pixels with this GeoKeyDirectory."""
    data = struct.pack(f"<{len(keys)}H", *keys) + b"\1\2\3\4"
    tags = [(256, 3, 1, 2), (257, 3, 1, 2), (258, 3, 1, 8), (259, 3, 1, 1), (262, 3, 1, 1), (273, 4, 1, 8 + 2 * len(keys)), (277, 3, 1, 1), (278, 3, 1, 2), (279, 4, 1, 4)]
    if keys:
        tags.append((34735, 3, len(keys), 8))
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags) + bytes(4)
    return b"II*\0" + struct.pack("<I", 8 + len(data)) + data + directory


def model(choice, cameras, images, points):
    return bytes([choice]) + struct.pack("<HH", len(cameras), len(images)) + cameras + images + points


def binary_model():
    cameras = struct.pack("<QIiQQ4d", 1, 1, 1, 100, 80, 90, 90, 50, 40)
    images = struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0, 0, 1, 1) + b"a.tif\0" + struct.pack("<Q2dq", 1, 10, 20, 1)
    points = struct.pack("<QQ3d3BdQii", 1, 1, 1, 2, 3, 9, 9, 9, 0.5, 1, 1, 0)
    return cameras, images, points


def text_model():
    return b"1 PINHOLE 100 80 90 90 50 40\n", b"1 1 0 0 0 0 0 1 1 a.tif\n10 20 1\n", b"1 1 2 3 9 9 9 0.5 1 0\n"


SEEDS = {
    "gcp_lists": (LISTS, [
        (".csv", b"name,easting,northing,height,sigma_m,role,crs\nP1,570406.861,7032516.804,80.3,0.01,check,EPSG:25832\nP2,570413,7032503,79,,,\n"),
        (".csv", b"Navn;Nord;\xc3\x98st;H\xc3\xb8yde\nP1;7032516,80;570406,86;80,1\n"),
        (".txt", b"EPSG:25832\n570406 7032516 80 10 20 a.jpg A\n"),
        (".points", b"#CRS: EPSG:25832\nmapX,mapY,sourceX,sourceY,enable,dX,dY,residual\n570406,7032516,3,-4,1,0,0,0\n"),
        (".kof", b" 05 P1        5001     7032516.804   570406.861  80.318\n"),
        (".xml", b'<document><chunk><markers><marker label="A"><reference x="570406" y="7032516" z="80" enabled="1"/></marker></markers></chunk></document>'),
        (".csv", "Číslo bodu;Y (Východ);X (Sever);Výška\n;[m];[m];[m]\n1;570406,8;7032516,8;80\n2;570413;7032503;79\nPrůměr;570409,9;7032509,9;79,5\n# EPSG 25832\n".encode()),
        (".csv", "点名,X座標,Y座標,標高\n1,7032516,570406,80\n".encode()),
        (".txt", b"*110001+0000000000000101 81..10+0000000569834260 82..10+0000007031894724 83..10+0000000000047211 \n110002+00000102 81..16+01234567 82..16+00500000\n"),
        (".txt", b"00NMSDR33\n08KI             101     7031894.724      569834.260          47.211GCP\n"),
        (".txt", b"JB,NMj\nMO,AD0,UN1\nSP,PN101,N 7031894.724,E 569834.26,EL47.211,--GCP\n--GS,PN7,N 7031900.1,E 569840.2,EL48.1,--n\n"),
        (".xml", b'<LandXML><Units><Imperial linearUnit="USSurveyFoot"/></Units><CoordinateSystem epsgCode="25832"/><CgPoints><CgPoint name="101">7031894.7 569834.2 47.2</CgPoint></CgPoints></LandXML>'),
        (".xml", b"<JOBFile><Reductions><Point><Name>101</Name><Grid><North>7031894.7</North><East>569834.2</East><Elevation>47.2</Elevation></Grid></Point></Reductions></JOBFile>"),
        (".geojson", b'{"type":"FeatureCollection","features":[{"type":"Feature","properties":{"name":"A"},"geometry":{"type":"Point","coordinates":[10.4,63.4,80]}}]}'),
        (".txt", b'FileHeader "SBG Object Text v2.01","Coordinate Document"\nbegin\n\tFileInfo "Coordinate System","Sweref 99 15 45 / RH2000"\nend\nPointList\nbegin\n\tPoint "101",7031894.724,569834.26,47.211,"GCP",0,""\nend\n'),
        (".txt", b'HEADER\nVERSION 1.20\nUNITS\nLINEAR METRE\nEND UNITS\nEND HEADER\nDATABASE\nPOINTS(PointNo, PointID, East, North, Elevation, Code, Date, CLASS)\n1, "101", 569834.26, 7031894.724, 47.211, "GCP", 01-06-2024/10:00:00.0, FIX;\nEND POINTS\n'),
        (".csv", b"WKT;name\nPOINT Z (570406.8 7032516.8 80.3);P1\nPOINT Z (570413 7032503 79);P2\n"),
        (".csv", b"name,lat,lon,h\nP1,63\xc2\xb025'12.3\"N,10\xc2\xb024'3.1\"E,80\n"),
        (".txt", b"P1 63.4205 10.4009 80.1\nP2 63.4206 10.4019 80.2\n"),
        (".txt", b"% program : RTKPOST\n%  GPST          latitude(deg) longitude(deg)  height(m)   Q  ns\n2024/06/01 10:00:00.000   63.420500000   10.400900000    80.1000   1   9\n"),
    ]),
    "documents": (DOCUMENTS, [
        (".toml", b'name = "p"\n[colour]\nlimit = 3.0\n[[colour.clouds]]\nmean = [60.0, 50.0, 60.0]\ncovariance = [[90.0, 0.0, 0.0], [0.0, 60.0, 0.0], [0.0, 0.0, 60.0]]\n[size]\nmin_px = 5.0\nmax_px = 60.0\n[filters]\nclosing_element = [".#.", "###"]\n'),
        (".json", b'{"schema":"autoref-stream-patch","schema_version":1,"for":"gcps","source":"a.autoref.json","edits":[{"gcp":"A","action":"move","x":3,"y":4}]}'),
        (".csv", b"x,y,score,cov_xx,cov_xy,cov_yy,area,width,height,elevation,probability,code\n12.5,40.25,3.5,0.01,0,0.01,96,12,12,80.1,0.9,aruco-4x4-50:7\n"),
        (".csv", b"red,green,blue\n255,120,10\n250,110,12\n"),
        (".xml", b'<TileMap><SRS>EPSG:3857</SRS><Origin x="1" y="2"/><TileFormat width="256" height="256" extension="png"/><TileSets profile="mercator"><TileSet href="1" units-per-pixel="2.5" order="1"/></TileSets></TileMap>'),
    ]),
    "flights": (FLIGHTS, [
        (".xml", b"<ExportAPERO><CalibrationInternConique><PP>900 890</PP><F>2100</F><SzIm>1800 1800</SzIm><CalibDistortion><ModRad><CDist>900 890</CDist><CoeffDist>1e-9</CoeffDist></ModRad></CalibDistortion></CalibrationInternConique></ExportAPERO>"),
        (".xml", b"<DicoAppuisFlottant><OneAppuisDAF><Pt>1 2 3</Pt><NamePt>A</NamePt><Incertitude>1 1 1</Incertitude></OneAppuisDAF></DicoAppuisFlottant>"),
        (".xml", b"<SetOfMesureAppuisFlottants><MesureAppuiFlottant1Im><NameIm>a.tif</NameIm><OneMesureAF1I><NamePt>A</NamePt><PtIm>1 2</PtIm></OneMesureAF1I></MesureAppuiFlottant1Im></SetOfMesureAppuisFlottants>"),
        (".json", b'[{"cameras":{"c":{"projection_type":"perspective","width":100,"height":80,"focal":0.9,"k1":0.0,"k2":0.0}},"shots":{"a.jpg":{"rotation":[0,0,0],"translation":[0,0,1],"camera":"c"}},"points":{}}]'),
        (".csv", b"name,x,y,z,yaw,pitch,roll\na.tif,1,2,3,90,-20,0\n"),
        (".txt", b"local\n1 2 3 10 20 a.tif A\n"),
        (".toml", b'name = "c"\nfilm_size_mm = [180.0, 180.0]\n'),
    ]),
    "outlines": (OUTLINES, [
        (".toml", b'[[sample]]\nclass = "sky"\nframe = "a.tif"\nrectangle = [0, 0, 5, 5]\n[[sample]]\nclass = "mask:kite"\nframe = "a.tif"\npolygon = [[1, 1], [9, 1], [5, 9]]\n'),
        (".geojson", b'{"frame":"a.tif","features":[{"type":"Feature","properties":{"class":"water"},"geometry":{"type":"Polygon","coordinates":[[[1,1],[9,1],[5,9],[1,1]]]}}]}'),
        (".txt", b"sky=1,2,30,40@a.tif"),
        (".txt", b"a.tif=a_Masq.tif"),
    ]),
    "geo_keys": ([".tif"], [(".tif", tiff(keys)) for keys in ([], [1, 1, 0, 1, 1025, 0, 1, 2], [1, 1, 0, 1, 3072, 0, 1, 25833])]),
    "models": (None, [model(0, *binary_model()), model(1, *text_model())]),
    "cloud_ply": (None, [
        b"ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\nend_header\n1 2 3\n4 5 6\n",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n" + struct.pack("<3f", 1, 2, 3),
        b"ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty list uchar int i\nend_header\n" + struct.pack(">3fBi", 1, 2, 3, 1, 7),
    ]),
    "cloud_las": (None, [las()]),
    "cloud_laz": (None, [las()]),
    "cloud_e57": (None, [e57()]),
    "cloud_xyz": (None, [b"x y z intensity\n1 2 3 4\n5 6 7 8\n", b"1;2;3\n4;5;6\n", b"// c\n1,2,3\n"]),
}


def main():
    target, folder = sys.argv[1], pathlib.Path(sys.argv[2])
    endings, seeds = SEEDS.get(target, ([], []))
    for number, seed in enumerate(seeds):
        content = seed if endings is None else bytes([endings.index(seed[0])]) + seed[1]
        (folder / f"seed-{number}").write_bytes(content)


if __name__ == "__main__":
    main()
