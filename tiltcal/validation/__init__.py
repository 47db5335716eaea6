"""How good a calibration or an online estimator is: acceptance, cross-checks, accuracy, uncertainty
budgets.
"""
