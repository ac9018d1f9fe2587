"""Names of the files in a study's folder."""

#: All rows; rows that are in no Parquet file yet; the folder of files with some thousand rows each.
ROWS, JOURNAL, PARTS = "runs.parquet", "journal.jsonl", "parts"
#: Who has it locks the folder.
LOCK = ".lock"
#: What the study is, what its runs say, its page, the best settings of a search.
ABOUT, STATISTICS, PAGE, BEST = "study.json", "statistics.json", "index.html", "best.yaml"
#: Of a search: Optuna's database, the folder of its runs' rows, and all trials.
DATABASE, TRIAL_ROWS, TRIALS = "trials.db", "trials", "trials.json"
#: What shows that a folder is a study's or a search's: one of these is there once its runs begin. Not the folders by themselves, whose
#: names others have too.
OWN = (ABOUT, JOURNAL, f"{PARTS}/*.parquet", ROWS, DATABASE, f"{TRIAL_ROWS}/{LOCK}")
