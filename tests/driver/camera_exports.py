"""Exports of thermal cameras' programs, rebuilt from public files and from public code that reads them; own numbers.

Each has the settings that it needs, and what it holds: the temperatures of its regions at their times.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .camera import camera

ROWS, COLUMNS = 4, 5
STEP_S = 0.5  # between frames
REGIONS = {
    "corner": {"quantity": "housing_temperature", "rows": [0, 0], "columns": [0, 0]},
    "middle": {"quantity": "winding_temperature", "rows": [1, 2], "columns": [1, 3], "statistic": "max"},
    "edge": {"quantity": "ambient_temperature", "rows": [3, 3], "columns": [2, 4]},
}
RATE = {"frame_rate_Hz": 1.0 / STEP_S}


def pixels(frame: int = 0) -> np.ndarray:
    """Temperatures of one frame [degC] (rows, columns), with two decimals of which none is a zero."""
    row, column = np.mgrid[:ROWS, :COLUMNS]
    return np.round(21.37 + 4.11 * row + 1.13 * column + 0.11 * row * column + 2.22 * frame, 2)


def region_values(*frames: np.ndarray) -> np.ndarray:
    """What the regions hold (frames, regions) [degC]."""
    return np.array([[frame[0, 0], frame[1:3, 1:4].max(), frame[3, 2:5].mean()] for frame in frames])


@dataclass(frozen=True)
class CameraExport:
    """One export, the settings that read it, and what it holds."""

    name: str
    maker: str
    program: str
    layout: str
    source: str
    texts: tuple[str, ...]  # one for each file
    values: np.ndarray  # (times, regions), degC
    time: dict[str, Any]
    encoding: str = "utf-8"
    settings: dict[str, Any] = field(default_factory=dict)
    regions: dict[str, Any] = field(default_factory=lambda: REGIONS)
    step_s: float = STEP_S
    ordered: bool = False  # whether rows are numbered or stamped, so that swapped ones are seen

    def files(self) -> list[bytes]:
        """Bytes of each file."""
        return [text.encode(self.encoding) for text in self.texts]

    def read(self, folder, files=None, without=()):
        """The record of these files, or of others instead; without some of the settings."""
        paths = [folder / f"export_{number}.csv" for number in range(len(self.texts))]
        for path, content in zip(paths, files or self.files(), strict=True):
            path.write_bytes(content)
        given = {name: value for name, value in self.settings.items() if name not in without}
        return camera(regions=self.regions, time=self.time, **given).read_files(paths)

    def row(self) -> str:
        """The row of this export in the table of the driver's page."""
        given = [f"`{name}: {shown(value)}`" for name, value in self.settings.items()]
        given += [f"`time.{name}: {shown(value)}`" for name, value in self.time.items()]
        cells = [self.maker, self.program, self.layout, self.encoding, ", ".join(given), self.source]
        return f"| {' | '.join(cells)} |"


def shown(value: Any) -> str:
    """A setting as YAML."""
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if value == "," else str(value)


def lines_of(frame, delimiter=";", decimal=".", end="", number="{:.2f}"):
    """The pixels of a frame as lines."""
    return [delimiter.join(number.format(value).replace(".", decimal) for value in row) + end for row in frame]


def text(*lines: str, end: str = "\r\n") -> str:
    """Lines with their ends."""
    return "".join(line + end for line in lines)


def series(head, rows, delimiter=",", end="\r\n"):
    """A table under a line of headings."""
    return text(head, *(delimiter.join(row) for row in rows), end=end)


ONE, TWO, THREE = pixels(0), pixels(1), pixels(2)
NUMBERED = "".join(f",{column}" for column in range(COLUMNS))
HIKMICRO_HEAD = [  # 16 lines, of which the third cell names a value and the fourth holds it
    "File Path,,,", "Device,,,", "Serial Number,,,", "Resolution,,,", "Time,,,", "Parameters,,,",
    ',,Emissivity,"0{d}95"', ',,Distance,"1{d}0"', ',,Humidity,"50{d}0"', ',,Reflected,"20{d}0"',
    ',,Optics,"20{d}0"', ',,Transmission,"1{d}0"', "Statistics,,,", ',,Min,"{low}"', ',,Max,"{high}"', ",,,",
]  # fmt: skip


def hikmicro_head(decimal: str, quote: bool) -> list[str]:
    """The lines above the pixels, with numbers in quotes where the decimal mark is the delimiter too."""
    filled = [
        line.replace("{d}", decimal)
        .replace("{low}", f"{ONE.min():.2f}".replace(".", decimal))
        .replace("{high}", f"{ONE.max():.2f}".replace(".", decimal))
        for line in HIKMICRO_HEAD
    ]
    return filled if quote else [line.replace('"', "").replace(",", ";") for line in filled]


def irbis_head(delimiter: str) -> list[str]:
    """The sections above the pixels."""
    return [
        "[Settings]",
        "Version=3",
        f"ImageWidth={COLUMNS}",
        f"ImageHeight={ROWS}",
        "ShotRange=20,00;80,00",
        "CalibRange=0,00;500,00",
        "TempUnit=C",
        "",
        "[MeasDefs]",
        "ID=" + delimiter.join(("M-Wert", "Min", "Max", "Bereich", "St.Abw.")),
        "",
    ]


def optris_lines(count: int = 6) -> list[str]:
    """The lines above the headings of a .dat file, which no reader uses."""
    return [f"Line {chr(ord('A') + number)}" for number in range(count)]


TWO_COLUMNS = {
    "winding": {"column": "Detector Area", "quantity": "winding_temperature"},
    "housing": {"column": "Hot Spot", "quantity": "housing_temperature"},
}
SERIES = np.array([[25.31, 24.97], [25.46, 25.02], [25.63, 25.08], [25.87, 25.19]])
CLOCK = ["10:15:30.111", "10:15:30.611", "10:15:31.111", "10:15:31.611"]


def halves(value: float) -> str:
    return f"{value:.2f}".replace(".", ",")


EXPORTS = [
    CameraExport(
        "flir_report_studio",
        "FLIR",
        "Report Studio, video to CSV",
        "frames, `Frame n` in the first cell of each one",
        "`parseImageCSV` and `getParamsHeader` of a public reader",
        (
            text(
                "File:,C:\\recordings\\heat.csq",
                "",
                "Parameters:,Emissivity:,0.95",
                ",Refl. temp:,20.0",
                ",Distance:,1.0",
                ",Atmospheric temp:,20.0",
                ",Ext. optics temp:,20.0",
                ",Ext. optics trans:,1.0",
                ",Relative humidity:,50.0",
                "",
                *(
                    line
                    for number, frame in enumerate((ONE, TWO, THREE), start=1)
                    for at, row in enumerate(lines_of(frame, ","))
                    for line in ((f"Frame {number}," if not at else ",") + row,)
                ),
            ),
        ),
        region_values(ONE, TWO, THREE),
        RATE,
        settings={"index_column": True, "frame_size": [ROWS, COLUMNS], "unit": "degC"},
    ),
    CameraExport(
        "flir_research_ir",
        "FLIR",
        "ResearchIR and ExaminIR, frames to CSV",
        "frames under `Time = ddd:hh:mm:ss.ffffff`",
        "files met in public",
        (
            text(
                *(
                    line
                    for number, frame in enumerate((ONE, TWO, THREE))
                    for line in (
                        f"Frame = {number}",
                        f"Time = 324:10:15:30.{111111 + 100000 * number}",
                        "Units = Temperature (C)",
                        *lines_of(frame, ","),
                        "",
                    )
                )
            ),
        ),
        region_values(ONE, TWO, THREE),
        {"line": "Time", "kind": "wall", "year": 2026, "zone": "+00:00"},
        settings={"frame_size": [ROWS, COLUMNS]},
        step_s=0.1,
    ),
    CameraExport(
        "flir_a70",
        "FLIR",
        "A70 over GigE Vision, log of regions",
        "series, elapsed seconds",
        "mattlmccoy/flir-research-interface, `validation/run01.csv`",
        (
            series(
                "time_s,frame_id,device_timestamp_ns,center_C,roi1_mean_C",
                [
                    [f"{STEP_S * k:g}", str(k + 1), str(1788301741194000000 + 500000000 * k), f"{a:.6f}", f"{b:.6f}"]
                    for k, (a, b) in enumerate(SERIES)
                ],
                end="\n",
            ),
        ),
        SERIES,
        {"column": "time_s", "units": "s"},
        settings={"unit": "degC"},
        regions={
            "winding": {"column": "center_C", "quantity": "winding_temperature"},
            "housing": {"column": "roi1_mean_C", "quantity": "housing_temperature"},
        },
        ordered=True,
    ),
    CameraExport(
        "flir_catalight",
        "FLIR",
        "infrared camera, ROI over time",
        "series, calendar stamps and elapsed seconds",
        "Dionne-Lab/catalight, `catalight/analysis/irdata.py`",
        (
            series(
                "abstime,reltime,ROI max,ROI mean",
                [
                    [f"2026-11-20 {stamp}000", f"{STEP_S * k:.1f}", f"{a:.2f}", f"{b:.2f}"]
                    for k, (stamp, (a, b)) in enumerate(zip(CLOCK, SERIES, strict=True))
                ],
            ),
        ),
        SERIES,
        {"column": "abstime", "zone": "+01:00"},
        settings={"unit": "degC"},
        regions={
            "winding": {"column": "ROI max", "quantity": "winding_temperature"},
            "housing": {"column": "ROI mean", "quantity": "housing_temperature"},
        },
        ordered=True,
    ),
    CameraExport(
        "hikmicro_korean",
        "HIKMICRO",
        "Analyzer, temperature matrix, Korean",
        "one frame, rows and columns numbered",
        "ji5zi5/auto_titration, `auto_titrator/thermal_camera.py`",
        (
            text(
                "파일 경로:,C:\\Users\\Public\\HIKMICRO Analyzer\\sample.csv,,,",
                "단위,섭씨,,,",
                f"통계:,,평균:,{ONE.mean():.2f},",
                f",,분:,{ONE.min():.2f},",
                f",,최대:,{ONE.max():.2f},",
                "축 X/Y" + NUMBERED,
                *(f"{at},{row}" for at, row in enumerate(lines_of(ONE, ","))),
            ),
        ),
        region_values(ONE),
        RATE,
        encoding="cp949",
        settings={"encoding": "cp949", "index_column": True},
        ordered=True,
    ),
    CameraExport(
        "hikmicro_comma",
        "HIKMICRO",
        "Analyzer, temperature matrix, decimal comma",
        "one frame under 16 lines, numbers in quotes",
        "Quadricopter/hikmicro, `modules/hikmicro.py`",
        (
            text(
                *hikmicro_head(",", quote=True),
                *(",".join(f'"{cell}"' for cell in row.split(";")) for row in lines_of(ONE, ";", ",")),
            ),
        ),
        region_values(ONE),
        RATE,
        encoding="cp1252",
        settings={"frame_size": [ROWS, COLUMNS], "unit": "degC"},
    ),
    CameraExport(
        "hikmicro_semicolon",
        "HIKMICRO",
        "Analyzer, temperature matrix, semicolons",
        "one frame under 16 lines",
        "KonlavachMengsuwan/Hikmicro-Temperature-Matrix-Convert-CSV-to-xlsx, `README.md`",
        (text(*hikmicro_head(".", quote=False), *lines_of(ONE, ";")),),
        region_values(ONE),
        RATE,
        settings={"frame_size": [ROWS, COLUMNS], "unit": "degC"},
    ),
    CameraExport(
        "optris_snapshot",
        "Optris",
        "PI 450 snapshot",
        "one frame under a line `columns,rows`",
        "loochlabs/temperature_parser, `data/Ellesmere_IR_flight01_1000ft_000028.csv`",
        (text(f"{COLUMNS},{ROWS}", *lines_of(ONE, ",")),),
        region_values(ONE),
        RATE,
        settings={"unit": "degC"},
    ),
    CameraExport(
        "optris_snapshot_comma",
        "Optris",
        "PIX Connect snapshot, decimal comma",
        "one frame, a comma between cells and as decimal mark",
        "`load_optris_imcsv` of a public reader",
        (text(*lines_of(ONE, ",", ",")),),
        region_values(ONE),
        RATE,
        settings={"decimal": ",", "frame_size": [ROWS, COLUMNS], "unit": "degC"},
    ),
    CameraExport(
        "optris_dat_comma",
        "Optris",
        "PIX Connect .dat, decimal comma",
        "series under 6 lines, a comma between cells and as decimal mark",
        "`optris_csv.py`, class `OptrisDataset`, of a public reader",
        (
            text(
                *optris_lines(),
                "Time,Detector Area,Hot Spot,",
                *(
                    f"{stamp.replace('.', ',')},{halves(a)},{halves(b)},"
                    for stamp, (a, b) in zip(CLOCK, SERIES, strict=True)
                ),
            ),
        ),
        SERIES,
        {"column": "Time"},
        encoding="cp1252",
        settings={"decimal": ",", "unit": "degC"},
        regions=TWO_COLUMNS,
        ordered=True,
    ),
    CameraExport(
        "optris_dat",
        "Optris",
        "PIX Connect .dat, semicolons",
        "series under 6 lines",
        '`optris_csv.py`, class `OptrisDataset`, with `delim=";"`',
        (
            text(
                *optris_lines(),
                "Time;Detector Area;Hot Spot;",
                *(f"{stamp};{a:.2f};{b:.2f};" for stamp, (a, b) in zip(CLOCK, SERIES, strict=True)),
            ),
        ),
        SERIES,
        {"column": "Time"},
        settings={"unit": "degC"},
        regions=TWO_COLUMNS,
        ordered=True,
    ),
    CameraExport(
        "irbis_csv",
        "InfraTec",
        "IRBIS, CSV",
        "one frame under `[Settings]`, `[MeasDefs]`, `[Data]`",
        "FireDynamics/FlameTrack, `tests/integration/generate_rotation_test_csvs.py`",
        (text(*irbis_head(";"), "[Data]", *lines_of(ONE, ";", ",", end=";"), end="\n"),),
        region_values(ONE),
        RATE,
        encoding="cp1252",
    ),
    CameraExport(
        "irbis_asc",
        "InfraTec",
        "IRBIS, sequence of .asc",
        "a file for each frame, with `RecTime`",
        "`ircam_reader.py` (P. Bourgault, 2018)",
        tuple(
            text(
                *irbis_head("\t"),
                "[Parameter]",
                "RecDate=20.11.2026",
                f"RecTime=10:15:{30 + number}",
                "",
                "[Data]",
                *lines_of(frame, "\t", ","),
            )
            for number, frame in enumerate((ONE, TWO))
        ),
        region_values(ONE, TWO),
        {"line": "RecTime"},
        encoding="cp1252",
        step_s=1.0,
    ),
    CameraExport(
        "irbis_txt",
        "InfraTec",
        "IRBIS 3, .txt of one frame",
        "one frame under 18 lines, tabs",
        "moritzva/ThermoApp, `create_thermo.py`",
        (
            text(
                *irbis_head("\t")[:8],
                "[Parameter]",
                "Description=°C",
                "FrameIndex=17",
                "RecDate=20.11.2026",
                "RecTime=10:15:30",
                "ms=120",
                "Emissivity=0,95",
                "Distance=1,0",
                "",
                "[Data]",
                *lines_of(ONE, "\t", ","),
            ),
        ),
        region_values(ONE),
        {"line": "FrameIndex", "kind": "frame", **RATE},
        encoding="cp1252",
        settings={"encoding": "cp1252"},
    ),
    CameraExport(
        "mobotix",
        "Mobotix",
        "thermal-raw, .celsius.csv",
        "one frame under `width;n`, `height;n`, `unit;degrees Celsius`",
        "waggle-sensor/plugin-mobotix-sampler, `mobotix_sdk/eventstreamclient/samples/thermal-raw/SinkVideo.cpp`",
        (
            text(
                "sensor;right",
                "bit depth;14 bit",
                f"width;{COLUMNS}",
                f"height;{ROWS}",
                "resolution;high",
                "advanced radiometry support;yes",
                "unit;degrees Celsius",
                "",
                *lines_of(ONE, ";", number="{:g}"),
                end="\n",
            ),
        ),
        region_values(ONE),
        RATE,
    ),
    CameraExport(
        "testo",
        "Testo",
        "IRSoft, CSV",
        "one frame under lines of names and values",
        "enesplaeng/Enes_goruntu_isleme, `16_testo865_isleme.py`",
        (text("testo 865;;;", "Emissivity;0,95;;", "Date;20.11.2026;;", *lines_of(ONE, ";", ",")),),
        region_values(ONE),
        RATE,
        settings={"frame_size": [ROWS, COLUMNS], "unit": "degC"},
    ),
    CameraExport(
        "fluke",
        "Fluke",
        "CSV of one image",
        "one frame, rows numbered, under lines of text",
        "moobydog0324-a11y/BCHP-THERMAL, `app/thermal-viewer/page.tsx`",
        (
            "\ufeff"
            + text(
                "Image,IR000123.IS2",
                "Emissivity,0.95",
                *(f"{at},{row}" for at, row in enumerate(lines_of(ONE, ","), 1)),
            ),
        ),
        region_values(ONE),
        RATE,
        encoding="utf-16-le",
        settings={"index_column": True, "frame_size": [ROWS, COLUMNS], "unit": "degC"},
        ordered=True,
    ),
    CameraExport(
        "infrec",
        "Nippon Avionics",
        "InfReC Analyzer, CSV",
        "one frame, tabs, rows and columns numbered below `y/x`",
        "`ThermogramProcessor.py` (K. Yagasaki, 2025)",
        (
            text(
                "ファイル名\theat_0001.svx",
                "放射率\t0.95",
                "y/x\t" + "\t".join(map(str, range(COLUMNS))),
                *(f"{at}\t{row}" for at, row in enumerate(lines_of(ONE, "\t"))),
            ),
        ),
        region_values(ONE),
        RATE,
        encoding="shift_jis",
        settings={"encoding": "shift_jis", "index_column": True, "unit": "degC"},
        ordered=True,
    ),
    CameraExport(
        "seek",
        "Seek Thermal",
        "CSV of a recording",
        "frames one below the other, nothing between them",
        "`convert_seek_to_lepton_format` of a public converter",
        (text(*(line for frame in (ONE, TWO, THREE) for line in lines_of(frame, ","))),),
        region_values(ONE, TWO, THREE),
        RATE,
        settings={"frame_size": [ROWS, COLUMNS], "unit": "degC"},
    ),
    CameraExport(
        "thermoviewer",
        "TeAx",
        "ThermoViewer, CSV",
        "a file for each frame, a semicolon behind each row",
        "`processIRTimelapse` of a public reader for the Tau 2",
        tuple(text(*lines_of(frame, ";", end=";")) for frame in (ONE, TWO)),
        region_values(ONE, TWO),
        RATE,
        settings={"frame_size": [ROWS, COLUMNS], "unit": "degC"},
    ),
]
