"""A study: a cohort of participants, each under several conditions on the same episodes; one folder, one report.

The study file (`plan`) says who takes part and what is compared. A participant is conducted part by part, through the
real processes over LSL (`conduct`) or with the same functions in one process (`loop`, `alone`), and each part that is
done is kept (`parts`), so that an interrupted study goes on. `tables` puts parts together, `page` shows them, and
`power` says how many participants a study needs.
"""
