"""Make the priors and the weights of learned predictors that come with usv-twin. See README.md."""

import argparse
from pathlib import Path

from population import make_prior

from twin.model.priors import KINDS, TANKER
from twin.model.structure import MODELS
from twin.particulars import DESIGNS

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("priors"), help="folder of the files")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for model in MODELS:
        for kind in (*KINDS, TANKER, *DESIGNS):
            path = given.out / f"{model}_{kind}.csv"
            if not path.exists():
                path.write_text(make_prior(model, kind, jobs=given.jobs).to_csv(), "utf-8")
            print(path, flush=True)
    for kind, name in (("lstm", "fleet-lstm.npz"), ("transformer", "fleet-transformer.npz")):
        if not (given.out / name).exists():
            from fleet import make_weights  # needs torch

            make_weights(kind, given.out, given.jobs).write(given.out / name)
        print(given.out / name, flush=True)
