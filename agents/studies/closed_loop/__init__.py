"""Does a diagnosis pay: drive, log, diagnose, extend the model, plan again, drive better?"""
