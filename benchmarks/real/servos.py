"""Servos of others: a pendulum of known weight, and a gear whose current is measured."""

from __future__ import annotations

import statistics

from benchmarks.real import bam_records
from benchmarks.real.bench import Bench, Criterion, File, Values


def _bam(minute: str, digest: str) -> File:
    name = f"2026-01-15_10h{minute}.json"
    return File(f"raw/{name}", f"bam/data.bak/raw/{name}", digest)


def _ratio(gain: int, values: Values) -> float:
    """The median over the records of a gain of what a volt turns with."""
    own = [v for name, v in values.items() if name.startswith(f"r_motor_kp{gain}_")]
    return values["k_T_motor"] / statistics.median(own)


BAM = Bench(
    name="bam",
    folder="dynamixel_pendulum_bam",
    repository="Rhoban/bam",
    commit="af2260462471ff45ac18af159b1327ea51d8db15",
    licence="Apache-2.0",
    published="k_T/R 0.068 (m1, 2026-02) and 0.096 (m1, 2026-07)",
    prepare=bam_records.convert_all,
    files=(
        _bam("28m10", "e58f3c2a08a5e0e37a2c5e930d0830a438bc102b8d21482767124f495b92f2ce"),
        _bam("28m17", "ef6507934ba465eb31529d7d98715ecc70bd5c87be049fd4618a94ce39290569"),
        _bam("28m24", "165b171df12b3e8b39504ce36d37e373ad105c0dddf4d3d073c747fd492e8bef"),
        _bam("28m32", "fdc255edae6995298af437f37582eb8cd0c4a5ddcec4f49fb7c4d6f3303aaa9c"),
        _bam("28m42", "1c6386bfa3be021c8ca8a96a7cbee93914f6271a050282b1c3b7d5ef373427db"),
        _bam("28m49", "e2223826274fca7799a2be0cb371e4269ead88cd9077fbb68498ef93e4e0de97"),
        _bam("28m57", "c10a350d9c7222d4d3499d140edd3ac4e63fe94f3b59a675116a34db7d66152c"),
        _bam("29m04", "7996c43314a9f60094a6119346b54ff9ff84cb6726c967f4a88a7175278f6515"),
        _bam("29m14", "016d15d21c464457aa30eaeab3977228b08cd5acf7542f24067440126c0bf480"),
        _bam("29m21", "fe68cff62e976c87a2fcab925a517fbff83be16c862693310fdc1eff743eddab"),
        _bam("29m29", "b9ce9fc0f396e6b03bd514e9254cb83b8a64e1a5df1728b9a10e3b4a5a9513ca"),
        _bam("29m37", "838d390b7190c4ce1608157cf629989648773b7336728a0931a61c6018c6700b"),
        _bam("29m47", "61ae8eeb881be5d8c09f6c7fba4cef39f66b1ff03e0148ef3bc0e314054513f5"),
        _bam("29m54", "b50055742ee553a8cb849b38d04d2b9bcf7143d0acefe6539f922984b93d958a"),
        _bam("30m02", "040e065f9885833fa909683f13665f90048ce5457d94dd2a3af056c21c36210d"),
        _bam("30m10", "01d32db99e7859f012a230aca59f1dda24219d6781472d356861b138526213e6"),
    ),
    criteria=(
        Criterion("eta_box", "1", lambda v: v["eta_box"], 0.6, 0.72),
        Criterion("k_T/R at gain 100", "N*m/V", lambda v: _ratio(100, v), 0.1, 0.12),
        Criterion("k_T/R at gain 800", "N*m/V", lambda v: _ratio(800, v), 0.075, 0.09),
    ),
    left=0.5,
)

PADOVA = Bench(
    name="padova",
    folder="geared_servo_padova",
    repository="Zod1s/MatLabUNIPD",
    commit="37ffd350edc82663c906dff99dd05b9bc5579f26",
    licence="none stated",
    published="data sheet: r 3.1 with the shunt, k_T 7.68e-3, j 3.9e-7; group: all that turns 5.74e-7",
    files=(
        File(
            "awu_resp.mat",
            "LabAuto/LabSperimentale3/awu_resp.mat",
            "068dee9a3fd25fc6e6b16a0d98735a277d845095a8de069069e63b74c0cf27af",
        ),
        File(
            "EM_resp.mat",
            "LabAuto/LabSperimentale4/EM_resp.mat",
            "d844926ba118c0bb6cb8df267cc9ebb8fadb183a328a2ccf90195de384c13d19",
        ),
    ),
    criteria=(
        Criterion("k_T_motor", "N*m/A", lambda v: v["k_T_motor"], 7.6e-3, 8.2e-3),
        Criterion("r_motor", "ohm", lambda v: v["r_motor"], 3.3, 3.7),
        Criterion(
            "all that turns", "kg*m**2", lambda v: v["j_motor"] + 3.42e-5 / 196, 5.7e-7, 6.2e-7
        ),
    ),
    left=0.2,
    disagrees=("c_motor",),
)
