"""The one table of formats: the suffix of a file, and the module that reads it. Nothing heavy is imported here.

A format is a module with `KIND` and `load(path)`, and `save(path, variables, attributes)` where it is written, too.
"""

RECORDS = {
    ".nc": "_netcdf",
    ".zarr": "_zarr",
    ".mat": "_matlab",
    ".npz": "_npz",
    ".csv": "_csv",
    ".txt": "_csv",
    ".tsv": "_csv",
    ".lvm": "_csv",
    ".parquet": "_parquet",
    ".mf4": "_mdf",
    ".mdf": "_mdf",
    ".dat": "_mdf",
}
SAVED = (".nc", ".mat", ".npz", ".zarr")
"""Records, and FRFs with all that is known of them."""
UNIVERSAL = (".uff", ".unv")
"""FRFs alone, as other programs exchange them."""
FRFS = (*SAVED, *UNIVERSAL)
