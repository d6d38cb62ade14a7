//! The robot's end in C, which comes with the program.

/// The files of the library for robots in C: the name of each and its text. They are the same for all models.
#[must_use]
pub fn library() -> [(&'static str, &'static str); 9] {
    [
        ("mom_rsp.h", include_str!("../../../rsp-c/mom_rsp.h")),
        (
            "mom_rsp_internal.h",
            include_str!("../../../rsp-c/mom_rsp_internal.h"),
        ),
        ("mom_rsp.c", include_str!("../../../rsp-c/mom_rsp.c")),
        ("mom_rsp_hear.c", include_str!("../../../rsp-c/mom_rsp_hear.c")),
        ("mom_rsp_say.c", include_str!("../../../rsp-c/mom_rsp_say.c")),
        (
            "mom_rsp_motion.c",
            include_str!("../../../rsp-c/mom_rsp_motion.c"),
        ),
        ("mom_rsp_seal.c", include_str!("../../../rsp-c/mom_rsp_seal.c")),
        (
            "mom_rsp_crypto.c",
            include_str!("../../../rsp-c/mom_rsp_crypto.c"),
        ),
        ("mom_rsp_blobs.c", include_str!("../../../rsp-c/mom_rsp_blobs.c")),
    ]
}
