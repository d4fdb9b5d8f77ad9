//! A deliberately hard real scene: hundreds of pumpkins, 4 to 8 px wide, on soil, straw and leaves.

use crate::scan::Detector;
use autoref_raster::Patch;
use autoref_raster::coords::PixelPoint;
use autoref_raster::window::Window;
use autoref_stream::learn::learn;
use autoref_stream::profile::Profile;
use autoref_synth::plant::Picture;

/// Side of a window that was counted.
const SIDE_PX: f64 = 500.0;

/// Upper left corner of the window of `pumpkin_field_13.jpg` that was counted.
const CORNER: (f64, f64) = (500.0, 400.0);

/// Every pumpkin that a person sees in that window, magnified four to six times: positions in the photograph, to about
/// a pixel. Those that touch are counted one by one; those cut by the window's edge, and leaves and straw of a similar
/// colour, are not.
#[rustfmt::skip]
const COUNTED: [(f64, f64); 316] = [
    (858.5, 405.0), (838.5, 405.5), (806.5, 415.5), (666.5, 426.5), (696.5, 426.5), (909.6, 425.9), (751.5, 429.5),
    (877.5, 430.5), (940.5, 430.5), (850.5, 432.5), (897.5, 436.5), (542.5, 438.5), (680.5, 438.5), (666.0, 440.1),
    (701.0, 440.1), (769.5, 439.5), (517.5, 442.5), (881.5, 441.5), (660.9, 442.8), (509.5, 443.5), (837.9, 444.2),
    (590.5, 446.5), (847.5, 446.5), (602.5, 448.5), (550.5, 455.5), (786.5, 455.5), (945.5, 456.5), (692.5, 458.5),
    (707.0, 459.1), (576.5, 460.5), (649.5, 461.5), (505.5, 464.5), (886.5, 464.5), (908.5, 467.5), (849.1, 470.1),
    (857.5, 469.5), (816.5, 471.5), (714.7, 473.3), (888.5, 476.5), (743.4, 476.7), (572.5, 477.5), (683.5, 480.5),
    (844.5, 479.5), (868.5, 479.5), (974.5, 479.5), (989.2, 481.3), (550.5, 482.5), (827.5, 481.5), (741.1, 486.1),
    (690.5, 487.5), (595.5, 490.5), (664.5, 489.5), (739.0, 489.7), (984.5, 489.5), (844.5, 493.5), (805.9, 498.2),
    (844.5, 500.5), (539.8, 500.7), (557.5, 501.5), (608.5, 503.5), (810.2, 504.2), (507.5, 513.5), (619.5, 518.5),
    (928.6, 519.0), (587.5, 522.5), (878.4, 528.9), (918.3, 530.5), (649.5, 532.5), (782.5, 531.5), (684.5, 536.5),
    (771.3, 535.5), (801.3, 536.0), (640.5, 540.5), (739.9, 540.3), (749.5, 540.5), (613.5, 542.5), (621.5, 545.5),
    (910.5, 545.5), (594.6, 550.4), (539.5, 552.5), (716.5, 554.5), (848.5, 555.5), (656.5, 558.5), (699.5, 558.5),
    (925.5, 558.5), (689.3, 560.3), (868.5, 559.5), (905.5, 560.5), (572.5, 562.5), (637.5, 561.5), (764.5, 562.5),
    (540.5, 565.5), (551.5, 566.5), (816.4, 566.7), (563.5, 568.5), (789.5, 568.5), (752.5, 570.5), (723.4, 572.2),
    (771.5, 572.5), (816.4, 571.7), (853.5, 572.5), (535.5, 573.5), (520.5, 575.5), (635.5, 575.5), (643.5, 576.5),
    (897.5, 576.5), (594.6, 576.7), (621.5, 577.5), (718.6, 578.1), (723.9, 578.1), (950.5, 578.5), (613.5, 579.5),
    (767.5, 580.5), (788.5, 580.5), (940.5, 580.9), (927.4, 582.7), (940.0, 585.4), (709.5, 585.5), (753.5, 585.5),
    (889.5, 586.5), (779.5, 588.5), (930.5, 587.5), (522.5, 590.5), (672.5, 590.5), (785.5, 590.5), (606.5, 593.5),
    (600.5, 598.5), (698.5, 598.5), (506.5, 602.5), (585.5, 602.5), (817.1, 602.8), (628.5, 608.5), (753.5, 610.5),
    (957.6, 609.9), (638.5, 613.5), (943.9, 615.2), (969.8, 614.5), (566.5, 616.5), (520.5, 617.5), (817.3, 618.2),
    (614.5, 620.5), (682.5, 620.5), (565.5, 624.6), (569.8, 625.5), (741.5, 625.5), (986.5, 627.8), (824.5, 630.5),
    (745.5, 632.5), (550.5, 633.5), (804.5, 637.5), (703.5, 642.5), (723.5, 641.5), (668.3, 645.4), (803.5, 648.5),
    (628.5, 650.5), (914.5, 650.5), (839.3, 650.7), (651.5, 652.5), (794.5, 651.5), (731.5, 656.5), (547.5, 659.5),
    (688.5, 659.5), (602.5, 661.5), (802.2, 663.7), (588.5, 666.5), (904.5, 666.5), (638.5, 667.5), (611.5, 670.5),
    (621.5, 671.5), (848.5, 673.5), (584.0, 674.7), (508.5, 679.5), (588.4, 680.2), (669.5, 679.5), (531.5, 682.5),
    (567.5, 682.5), (607.5, 683.5), (559.5, 686.5), (795.5, 686.5), (823.5, 685.5), (806.5, 687.1), (772.5, 687.5),
    (985.5, 688.5), (717.5, 690.5), (806.1, 692.4), (993.5, 692.5), (778.5, 694.5), (720.2, 694.6), (666.5, 695.5),
    (728.5, 695.5), (589.5, 698.5), (735.5, 699.5), (746.5, 700.5), (861.5, 699.5), (986.5, 699.5), (830.5, 702.5),
    (519.5, 704.5), (607.5, 704.5), (640.5, 703.5), (708.5, 704.5), (847.5, 706.5), (873.5, 705.5), (965.7, 705.6),
    (542.5, 708.5), (563.5, 707.5), (507.5, 709.5), (606.5, 709.5), (648.5, 712.5), (775.5, 711.5), (847.1, 713.6),
    (920.5, 714.5), (695.1, 715.7), (690.5, 718.7), (526.5, 719.5), (680.5, 719.5), (866.5, 720.5), (875.5, 722.5),
    (611.5, 724.5), (638.5, 726.5), (740.5, 727.5), (770.5, 728.5), (558.5, 734.5), (706.5, 734.5), (548.5, 744.5),
    (803.3, 746.2), (552.5, 747.5), (713.4, 748.4), (728.3, 747.5), (763.5, 748.5), (565.5, 751.5), (800.5, 751.5),
    (713.4, 755.3), (717.5, 756.5), (589.5, 761.5), (579.5, 762.5), (750.7, 761.7), (570.5, 763.8), (581.3, 767.9),
    (785.5, 775.5), (733.5, 781.5), (756.5, 782.5), (779.5, 782.5), (589.5, 784.5), (744.5, 783.5), (778.5, 788.5),
    (528.5, 790.5), (728.5, 794.5), (715.5, 796.5), (698.5, 796.5), (761.5, 798.5), (810.5, 797.5), (757.6, 803.8),
    (549.5, 808.5), (539.5, 811.5), (678.1, 811.6), (774.5, 811.5), (724.5, 814.5), (843.5, 814.5), (803.5, 815.5),
    (735.5, 818.5), (829.5, 817.5), (668.7, 819.4), (573.5, 829.5), (865.5, 830.5), (552.5, 832.5), (794.5, 832.5),
    (560.5, 834.5), (853.5, 834.5), (888.5, 834.5), (690.5, 838.5), (736.5, 838.5), (823.5, 838.5), (509.5, 841.5),
    (514.5, 842.5), (938.5, 841.5), (552.5, 844.5), (837.5, 843.5), (887.5, 844.5), (692.5, 846.5), (739.5, 846.5),
    (945.7, 845.7), (955.5, 845.5), (928.5, 847.5), (790.3, 851.5), (504.5, 854.5), (519.7, 855.6), (526.5, 856.5),
    (586.5, 855.5), (604.5, 855.5), (840.5, 859.5), (550.5, 864.5), (584.5, 864.5), (609.5, 864.5), (625.5, 864.5),
    (664.8, 865.2), (545.5, 866.5), (696.5, 865.5), (836.5, 867.5), (864.5, 868.5), (795.5, 870.5), (861.5, 872.5),
    (880.5, 872.5), (892.5, 872.5), (724.4, 872.8), (535.5, 874.5), (561.5, 873.5), (847.5, 874.5), (938.5, 873.5),
    (557.5, 876.5), (592.5, 875.5), (630.5, 876.5), (731.5, 876.5), (680.5, 877.5), (782.5, 878.5), (583.5, 879.5),
    (761.0, 885.3),
];

/// Upper left corner of the window of `pumpkin_field_14.jpg`, counted after everything was made and before it was tried
/// there.
const HELD_OUT_CORNER: (f64, f64) = (300.0, 200.0);

/// What a person counts as pumpkins in that window, magnified seven times, to about a pixel: round and orange, from
/// peach to deep, one by one where they touch. Not counted: what the window's edge cuts, yellow or olive spots, faint
/// stains.
#[rustfmt::skip]
const HELD_OUT: [(f64, f64); 308] = [
    (570.0, 205.5), (585.5, 206.0), (791.0, 206.5), (596.0, 207.5), (421.0, 209.0), (590.5, 209.5), (662.0, 209.5),
    (780.0, 210.5), (377.0, 211.0), (366.5, 215.5), (791.5, 217.5), (549.5, 218.0), (472.0, 219.5), (402.5, 222.0),
    (525.0, 224.5), (638.0, 227.0), (347.5, 227.5), (746.5, 228.5), (324.0, 229.5), (720.0, 231.0), (697.5, 232.5),
    (625.0, 233.5), (307.0, 235.0), (559.0, 236.0), (426.0, 236.5), (358.5, 237.0), (516.5, 241.0), (569.0, 241.0),
    (626.0, 241.0), (327.5, 243.5), (484.5, 243.5), (311.0, 247.5), (385.5, 248.0), (590.5, 248.5), (302.0, 249.0),
    (586.0, 249.0), (319.0, 249.5), (420.0, 249.5), (495.0, 253.0), (403.5, 255.5), (509.0, 257.5), (765.5, 259.5),
    (408.0, 264.5), (328.0, 265.0), (373.5, 267.0), (358.5, 268.5), (762.0, 279.0), (729.0, 285.5), (792.5, 295.5),
    (599.0, 300.0), (795.0, 317.0), (738.5, 323.5), (710.5, 324.0), (723.0, 324.0), (644.5, 326.5), (663.0, 328.5),
    (658.0, 330.5), (534.0, 334.5), (588.0, 338.5), (557.5, 341.5), (759.0, 343.0), (529.5, 343.5), (538.5, 343.5),
    (680.0, 344.0), (617.0, 344.5), (644.5, 347.5), (694.0, 349.5), (752.5, 350.5), (476.0, 352.0), (682.5, 352.0),
    (554.0, 352.5), (699.5, 353.0), (733.5, 353.5), (458.0, 354.0), (689.0, 356.5), (412.5, 358.0), (549.5, 361.5),
    (358.0, 363.0), (702.0, 363.0), (584.5, 364.5), (722.0, 365.5), (344.5, 366.0), (573.5, 366.5), (755.0, 367.0),
    (633.5, 368.5), (303.5, 369.0), (489.5, 370.0), (554.0, 372.5), (574.5, 373.0), (414.5, 375.5), (503.5, 375.5),
    (364.0, 377.0), (457.0, 377.0), (625.0, 379.5), (773.5, 379.5), (663.5, 380.5), (711.5, 380.5), (742.5, 381.5),
    (706.5, 383.5), (622.5, 384.0), (373.5, 384.5), (570.0, 385.5), (661.5, 385.5), (425.5, 386.0), (508.0, 387.0),
    (704.5, 389.0), (578.0, 391.0), (686.0, 392.0), (753.5, 392.5), (541.5, 394.5), (610.0, 395.0), (469.0, 396.5),
    (444.0, 398.5), (596.5, 399.0), (770.5, 400.5), (390.5, 404.5), (461.5, 404.5), (533.5, 404.5), (503.5, 405.5),
    (415.5, 406.5), (546.0, 407.0), (762.5, 409.0), (341.0, 412.0), (413.5, 417.0), (375.0, 420.0), (703.5, 421.5),
    (683.0, 422.0), (624.0, 424.0), (726.0, 427.5), (780.5, 428.5), (760.5, 430.5), (775.0, 430.5), (504.5, 431.0),
    (718.5, 431.0), (396.0, 432.0), (698.0, 433.0), (725.5, 433.0), (623.0, 435.5), (773.0, 437.5), (797.5, 437.5),
    (625.5, 441.5), (704.5, 441.5), (664.0, 442.0), (657.0, 442.5), (632.0, 445.0), (521.0, 449.5), (596.0, 450.0),
    (762.0, 450.5), (752.5, 452.5), (671.0, 454.0), (624.5, 455.0), (536.0, 457.0), (637.5, 457.5), (692.5, 458.5),
    (444.0, 465.5), (451.5, 468.0), (391.0, 468.5), (596.0, 469.5), (618.0, 469.5), (502.0, 472.0), (767.5, 472.0),
    (332.0, 478.5), (674.0, 478.5), (570.0, 481.0), (632.0, 483.0), (693.5, 483.0), (790.0, 484.0), (542.0, 484.5),
    (703.0, 487.0), (340.5, 490.0), (392.5, 493.5), (479.5, 494.5), (654.5, 494.5), (699.5, 498.0), (786.0, 498.5),
    (364.5, 501.5), (604.0, 501.5), (622.5, 502.5), (346.0, 504.5), (364.5, 510.5), (548.0, 513.5), (329.0, 514.5),
    (503.0, 515.5), (760.0, 515.5), (462.5, 520.0), (544.5, 523.5), (466.5, 528.0), (487.0, 532.0), (378.0, 535.0),
    (734.0, 535.5), (389.0, 536.0), (423.0, 538.0), (459.5, 539.5), (651.0, 539.5), (689.0, 539.5), (432.0, 540.5),
    (476.5, 541.5), (499.5, 542.0), (666.5, 542.5), (356.5, 544.0), (555.0, 545.0), (538.0, 546.0), (339.0, 547.5),
    (588.0, 548.5), (660.5, 550.5), (795.5, 552.0), (615.5, 553.0), (491.5, 555.0), (745.0, 555.5), (663.0, 557.5),
    (473.5, 559.0), (788.0, 559.0), (443.5, 559.5), (638.0, 560.0), (700.0, 561.0), (605.5, 563.5), (507.0, 564.0),
    (645.0, 564.0), (485.5, 565.0), (311.5, 565.5), (589.0, 565.5), (558.0, 566.0), (755.0, 566.0), (766.0, 566.5),
    (361.5, 567.5), (540.0, 571.0), (565.0, 571.0), (612.0, 574.0), (597.0, 575.0), (390.0, 577.5), (468.0, 577.5),
    (514.0, 579.5), (495.0, 580.0), (525.0, 580.0), (793.0, 580.0), (555.0, 580.5), (688.0, 582.0), (529.5, 584.0),
    (718.5, 584.5), (791.5, 587.5), (384.5, 588.0), (420.5, 588.5), (719.5, 589.5), (780.0, 591.0), (310.0, 592.0),
    (455.0, 593.5), (336.5, 594.5), (722.5, 594.5), (745.5, 595.0), (714.5, 595.5), (412.0, 597.0), (624.0, 597.0),
    (655.0, 597.5), (594.5, 598.0), (331.5, 598.5), (574.5, 598.5), (457.0, 600.0), (651.0, 600.5), (645.0, 604.0),
    (766.5, 604.0), (586.0, 606.5), (571.5, 609.0), (540.0, 610.0), (788.5, 610.0), (703.0, 611.0), (456.0, 611.5),
    (478.5, 611.5), (759.5, 611.5), (586.5, 612.0), (735.5, 612.0), (620.0, 612.5), (683.5, 615.0), (393.0, 616.0),
    (498.0, 617.0), (755.5, 618.0), (413.0, 620.0), (626.0, 621.5), (604.0, 624.5), (682.0, 625.0), (662.0, 628.0),
    (702.0, 628.0), (638.0, 629.0), (545.5, 629.5), (652.0, 632.0), (621.5, 634.5), (543.0, 635.0), (332.5, 635.5),
    (521.0, 638.0), (778.0, 640.0), (732.5, 642.0), (533.5, 642.5), (586.5, 643.5), (677.5, 643.5), (521.5, 645.0),
    (661.5, 645.5), (786.0, 647.5), (572.0, 650.0), (324.5, 653.0), (472.0, 655.5), (590.5, 655.5), (528.0, 658.5),
    (309.0, 659.5), (587.5, 661.0), (475.5, 666.0), (613.5, 673.5), (764.5, 683.0), (615.5, 683.5), (626.5, 693.5),
];

fn patch(picture: &Picture, x: f64, y: f64, reach: u64) -> Patch {
    let bounds = Window::whole(picture.width as u64, picture.height as u64);
    let window = Window::new(x as u64, y as u64, 1, 1).grown(reach, &bounds);
    let cut = picture.crop(window.x as usize, window.y as usize, window.width as usize, window.height as usize);
    let rgb: Vec<[u16; 3]> = cut.rgb.iter().map(|c| c.map(u16::from)).collect();
    Patch { window, valid: vec![true; rgb.len()], rgb, white: 255 }
}

/// Five that stand alone, spread over the window.
fn taught(picture: &Picture, counted: &[(f64, f64)]) -> Profile {
    let alone = |p: &(f64, f64)| counted.iter().all(|q| q == p || (p.0 - q.0).hypot(p.1 - q.1) > 12.0);
    let marks: Vec<(f64, f64)> = counted.iter().copied().filter(alone).collect();
    let marks: Vec<_> = (0..5)
        .map(|k| marks[(2 * k + 1) * marks.len() / 10])
        .map(|(x, y)| (patch(picture, x, y, 20), PixelPoint { x, y }))
        .collect();
    learn("pumpkin", &marks).expect("pumpkins stand out")
}

/// How many of the counted are candidates, and the candidates in the window.
fn hits(picture: &Picture, profile: &Profile, corner: (f64, f64), counted: &[(f64, f64)]) -> (usize, usize) {
    let found = Detector::new(profile.clone()).list(picture);
    let inside = |c: &&autoref_stream::candidate::Candidate| {
        (corner.0..corner.0 + SIDE_PX).contains(&c.centre.x) && (corner.1..corner.1 + SIDE_PX).contains(&c.centre.y)
    };
    let near =
        |p: &(f64, f64)| found.iter().map(|c| (c.centre.x - p.0).hypot(c.centre.y - p.1)).fold(f64::INFINITY, f64::min);
    let hit = counted.iter().filter(|p| near(p) <= 3.0).count();
    let inside = found.iter().filter(inside).count();
    println!("{hit} of {} counted; {inside} candidates in the window", counted.len());
    (hit, inside)
}

#[test]
fn counted_pumpkins_are_candidates_of_a_profile_taught_by_five() {
    let Some(picture) = crate::drawn_targets::photo("photos/pumpkin_field_13.jpg") else { return };
    let (hit, _) = hits(&picture, &taught(&picture, &COUNTED), CORNER, &COUNTED);
    assert!(hit * 100 >= COUNTED.len() * 95, "{hit} of {}", COUNTED.len());
}

#[test]
fn the_held_out_window_is_counted_as_well() {
    let Some(picture) = crate::drawn_targets::photo("photos/pumpkin_field_14.jpg") else { return };
    let (hit, _) = hits(&picture, &taught(&picture, &HELD_OUT), HELD_OUT_CORNER, &HELD_OUT);
    assert!(hit * 100 >= HELD_OUT.len() * 95, "{hit} of {}", HELD_OUT.len());
    if !crate::common::large() {
        return;
    }
    // The lesson of the neighbouring photograph serves as well.
    let Some(other) = crate::drawn_targets::photo("photos/pumpkin_field_13.jpg") else { return };
    let (hit, _) = hits(&picture, &taught(&other, &COUNTED), HELD_OUT_CORNER, &HELD_OUT);
    assert!(hit * 100 >= HELD_OUT.len() * 95, "{hit} of {}", HELD_OUT.len());
}

mod whole_program {
    //! GCP marks among thousands of pumpkins, through the program: image and list in, matches out.

    use std::path::Path;
    use std::process::Command;

    use autoref_stream::profile::Profile;
    use autoref_synth::{self as synth, Background, Compression, MarkSize, MarkStyle, Shape, SynthSpec, Truth};
    use serde_json::Value;

    use super::{COUNTED, taught};

    /// The three photographs laid side by side and mirrored over `side` pixels, with 20 marks.
    fn scene(folder: &Path, side: u64, mark: MarkStyle, seed: u64) -> Option<Truth> {
        let photo = |k: u32| format!("{}/../shared/data/photos/pumpkin_field_{k}.jpg", crate::common::root().display());
        let photos: Vec<_> = (12..15).map(|k| photo(k).into()).collect();
        if photos.iter().any(|p: &std::path::PathBuf| !p.exists()) {
            crate::common::skipped("the photographs are absent");
            return None;
        }
        let extent_m = 0.03 * side as f64 * 0.87;
        let mut spec = SynthSpec {
            gcps: synth::random_gcps(20, extent_m, extent_m, seed),
            size_px: Some((side, side)),
            rotation_deg: 33.0,
            background: Background::Photographs(photos),
            mark,
            seed,
            ..SynthSpec::default()
        };
        spec.output.compression = Compression::Deflate;
        let truth = synth::write(&spec, &folder.join("field.tif")).expect("a sample");
        synth::write_gcp_geojson(&folder.join("field.geojson"), &spec.gcps, Some(32632)).expect("a list");
        Some(truth)
    }

    fn run(folder: &Path, profile: &Profile, memory: &str) -> Value {
        let file = folder.join("profile.toml");
        std::fs::write(&file, profile.to_toml()).expect("writable");
        let output = Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
            .arg(folder.join("field.tif"))
            .arg("--gcps")
            .arg(folder.join("field.geojson"))
            .arg("--profile")
            .arg(&file)
            // The scale is known to ±10 %.
            .args(["--gsd", "0.03", "--memory", memory, "--json", "--no-report"])
            .output()
            .expect("the program starts");
        let result: Value = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&output.stderr)));
        println!(
            "{}: {} candidates, {} matched, scan {:.1} s, match {:.1} s, {:.1} s in all, {} MiB",
            result["status"],
            result["candidates_found"],
            result["matches"].as_array().map_or(0, Vec::len),
            result["timings"]["scan_s"].as_f64().unwrap_or(f64::NAN),
            result["timings"]["match_s"].as_f64().unwrap_or(f64::NAN),
            result["elapsed_s"].as_f64().unwrap_or(f64::NAN),
            result["peak_memory_bytes"].as_u64().unwrap_or(0) >> 20
        );
        result
    }

    /// So near, pixels, that the place found lies on the mark, which is 7 or 10 px wide. A mark that touches a pumpkin
    /// of its own colour is one shape with it, and seen towards it.
    const ON_MARK_PX: f64 = 3.5;

    /// How many marks are matched; each at its own place.
    fn right(truth: &Truth, result: &Value) -> usize {
        let rows = result["matches"].as_array().expect("a list");
        for row in rows {
            let gcp = truth.gcps.iter().find(|g| g.name == row["gcp"]).expect("a name of the list");
            let off = (row["x"].as_f64().expect("x") - gcp.x).hypot(row["y"].as_f64().expect("y") - gcp.y);
            if off > 1.0 {
                println!("{} is {off:.2} px off", gcp.name);
            }
            assert!(gcp.visible && off < ON_MARK_PX, "{} is {off:.2} px off", gcp.name);
        }
        rows.len()
    }

    /// Orange marks, and a profile taught from five of them.
    fn orange_marks(side: u64) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mark = MarkStyle { size: MarkSize::Px(10.0), fading: 0.2, ..MarkStyle::default() };
        let Some(truth) = scene(folder.path(), side, mark, 9) else { return };
        let file = folder.path().join("taught.toml");
        let mut sample = Command::new(env!("CARGO_BIN_EXE_autoref-stream"));
        sample.arg("sample").arg(folder.path().join("field.tif")).arg("-o").arg(&file);
        for gcp in truth.visible().take(5) {
            sample.arg("--at").arg(format!("{:.1},{:.1}", gcp.x, gcp.y));
        }
        assert!(sample.status().expect("the program starts").success());
        let profile = Profile::load(file.to_str().expect("plain")).expect("a profile");
        let result = run(folder.path(), &profile, "512M");
        assert_eq!(result["status"], "solved", "{}", result["reason"]);
        assert_eq!(right(&truth, &result), truth.visible().count(), "not found: {}", result["not_found"]);
    }

    /// Marks that look like pumpkins, and a profile taught from five pumpkins: every pumpkin is a candidate.
    fn marks_like_pumpkins(side: u64, seed: u64) -> Option<(Truth, Value)> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let picture = crate::drawn_targets::photo("photos/pumpkin_field_13.jpg")?;
        let profile = taught(&picture, &COUNTED);
        let mark = MarkStyle {
            size: MarkSize::Px(7.0),
            shape: Shape::Disc,
            fading: 0.2,
            paints: vec!["#dc9c62".parse().expect("a colour")],
            ..MarkStyle::default()
        };
        let truth = scene(folder.path(), side, mark, seed)?;
        let result = run(folder.path(), &profile, "512M");
        println!("seed {seed}: not found: {}", result["not_found"]);
        Some((truth, result))
    }

    fn large() -> bool {
        std::env::var_os("AUTOREF_LARGE").is_some()
    }

    #[test]
    fn orange_marks_among_pumpkins_are_matched() {
        orange_marks(if large() { 5000 } else { 2000 });
    }

    #[test]
    fn marks_like_pumpkins_are_told_by_their_pattern() {
        let (side, seeds) = if large() { (3000, 9..14) } else { (1300, 9..10) };
        for seed in seeds {
            let Some((truth, result)) = marks_like_pumpkins(side, seed) else { return };
            assert_eq!(result["status"], "solved", "{}", result["reason"]);
            let found = right(&truth, &result);
            assert_eq!(found, truth.visible().count(), "seed {seed}, not found: {}", result["not_found"]);
        }
    }

    /// 100,000 candidates: right or refused, in bounded memory and time.
    #[test]
    fn a_hundred_thousand_candidates_stay_bounded() {
        if !large() {
            return;
        }
        let Some((truth, result)) = marks_like_pumpkins(8000, 9) else { return };
        assert!(result["candidates_found"].as_u64() >= Some(100_000), "{}", result["candidates_found"]);
        assert!(result["peak_memory_bytes"].as_u64() <= Some(512 << 20), "{}", result["peak_memory_bytes"]);
        assert!(result["elapsed_s"].as_f64() < Some(3600.0), "{}", result["elapsed_s"]);
        if result["status"] == "solved" {
            right(&truth, &result);
        }
    }
}
