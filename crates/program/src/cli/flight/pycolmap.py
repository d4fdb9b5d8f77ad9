"""COLMAP's commands by pycolmap 4: the options of the command line, as far as `flight solve` gives them."""

import sys

try:
    import numpy
    import pycolmap
except ImportError as error:
    print(error)
    sys.exit(71)

if int(pycolmap.__version__.split(".")[0]) < 4:
    print(f"pycolmap {pycolmap.__version__} is older than version 4")
    sys.exit(72)

command = sys.argv[1]
given = {key[2:]: value for key, value in zip(sys.argv[2::2], sys.argv[3::2])}
database_path = given["database_path"]


def reader():
    options = pycolmap.ImageReaderOptions()
    options.camera_model = given.get("ImageReader.camera_model", options.camera_model)
    options.camera_params = given.get("ImageReader.camera_params", "")
    if "ImageReader.mask_path" in given:
        options.mask_path = given["ImageReader.mask_path"]
    mode = pycolmap.CameraMode.SINGLE if given.get("ImageReader.single_camera") == "1" else pycolmap.CameraMode.AUTO
    names = open(given["image_list_path"], encoding="utf-8").read().splitlines() if "image_list_path" in given else []
    return options, mode, names


def feature_extractor():
    options, mode, names = reader()
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu = False
    extraction.num_threads = int(given.get("SiftExtraction.num_threads", -1))
    extraction.sift.max_num_features = int(given["SiftExtraction.max_num_features"])
    extraction.sift.first_octave = int(given.get("SiftExtraction.first_octave", -1))
    pycolmap.extract_features(
        database_path, given["image_path"], image_names=names, camera_mode=mode, reader_options=options,
        extraction_options=extraction, device=pycolmap.Device.cpu,
    )


def feature_importer():
    options, mode, names = reader()
    pycolmap.Database.open(database_path).close()
    pycolmap.import_images(database_path, given["image_path"], camera_mode=mode, image_names=names, options=options)
    with pycolmap.Database.open(database_path) as database:
        for image in database.read_all_images():
            lines = open(f"{given['import_path']}/{image.name}.txt", encoding="utf-8").read().splitlines()[1:]
            points = numpy.array([line.split(" ", 4)[:4] for line in lines], numpy.float32).reshape(-1, 4)
            database.write_keypoints(image.image_id, points)


def matches_importer():
    if given["match_type"] == "pairs":
        matching, pairing = pycolmap.FeatureMatchingOptions(), pycolmap.ImportedPairingOptions()
        matching.use_gpu, matching.num_threads = False, 1
        pairing.match_list_path = given["match_list_path"]
        pycolmap.match_image_pairs(database_path, matching, pairing, geometry(), pycolmap.Device.cpu)
        return
    with pycolmap.Database.open(database_path) as database:
        number = {image.name: image.image_id for image in database.read_all_images()}
        for block in open(given["match_list_path"], encoding="utf-8").read().split("\n\n"):
            head, _, rest = block.strip().partition("\n")
            if rest:
                # Two names with a blank between them, either of which may have more.
                words = head.split(" ")
                pairs = ((" ".join(words[:k]), " ".join(words[k:])) for k in range(1, len(words)))
                one, two = next((one, two) for one, two in pairs if one in number and two in number)
                matches = numpy.array([row.split() for row in rest.splitlines()], numpy.uint32)
                database.write_matches(number[one], number[two], matches)
    verifier = pycolmap.GeometricVerifierOptions()
    verifier.num_threads = 1
    pycolmap.geometric_verification(database_path, verifier, two_view_geometry_options=geometry())


def geometry():
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = 0
    return options


def mapper():
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.random_seed = int(given["random_seed"])
    options.ba_refine_focal_length = given["Mapper.ba_refine_focal_length"] == "1"
    options.ba_refine_principal_point = False
    options.min_model_size = int(given["Mapper.min_model_size"])
    models = pycolmap.incremental_mapping(database_path, given["image_path"], given["output_path"], options)
    if not models:
        print("failed to create sparse model")
        sys.exit(1)


pycolmap.set_random_seed(int(given.get("random_seed", 0)))
{f.__name__: f for f in (feature_extractor, feature_importer, matches_importer, mapper)}[command]()
